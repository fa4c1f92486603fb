import os

import hypothesis

# A defect of the lowering, which users see as a line of warning and XLA, is an error here.
os.environ["SIGMAX_DEFECTS"] = "raise"

# Compiling makes the first example slow; what matters here is what is computed.
hypothesis.settings.register_profile("sigmax", deadline=None, max_examples=60, derandomize=True)
hypothesis.settings.load_profile("sigmax")
