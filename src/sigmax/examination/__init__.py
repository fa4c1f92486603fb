"""What is wrong with a model: causes of a record that its filter does not believe, sized and proven by re-running."""

from sigmax.examination.examine import doctor, not_examined
from sigmax.examination.report import Evidence, Examination, Finding

__all__ = ["Evidence", "Examination", "Finding", "doctor", "not_examined"]
