"""Small dense algebra on component-first arrays: the only place where a factorisation can fail."""
