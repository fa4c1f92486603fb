"""Laws that any implementation of a filter can be tested against, through an adapter of a few lines.

```python
outcomes = check(Adapter("mine", MyFilter))
```

where `MyFilter(task, mean, cov)` starts a filter that has `predict()`, `update(z)`, `mean` and `cov`.
"""

from sigmax.conformance.check import Outcome, check
from sigmax.conformance.laws import LAWS, Law
from sigmax.conformance.own import own
from sigmax.conformance.task import Adapter, Running, Task

__all__ = ["LAWS", "Adapter", "Law", "Outcome", "Running", "Task", "check", "own"]
