"""Studies: a grid over fields of the specification, one table of figures, and the front of the best trade-offs."""
