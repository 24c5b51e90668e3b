"""The constrained connected maximum cut (paper, section 4.2)."""
