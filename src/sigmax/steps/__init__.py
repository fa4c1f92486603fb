"""One step of a filter: predict, correct and back, each a pure function of small arrays."""
