"""Studies: a grid over the specification, run as designs that share cached steps."""
