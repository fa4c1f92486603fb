"""What is wrong with a model: causes of a record that its filter does not believe, sized and proven by re-running."""

from sigmax.examination.examine import doctor
from sigmax.examination.report import Examination, Finding

__all__ = ["Examination", "Finding", "doctor"]
