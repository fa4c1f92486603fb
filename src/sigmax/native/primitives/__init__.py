"""How each primitive of a traced function becomes scalar operations: a rule for each, registered by its file."""

from sigmax.native.primitives import elementwise, indexing, integer_rules, integer_types, linear_algebra, structure

__all__ = ["elementwise", "indexing", "integer_rules", "integer_types", "linear_algebra", "structure"]
