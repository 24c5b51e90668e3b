"""The scalar field whose sign names the fluid: positive hot, negative cold (paper, section 5)."""
