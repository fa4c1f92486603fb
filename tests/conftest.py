import hypothesis

# Compiling makes the first example slow; what matters here is what is computed.
hypothesis.settings.register_profile("sigmax", deadline=None, max_examples=60, derandomize=True)
hypothesis.settings.load_profile("sigmax")
