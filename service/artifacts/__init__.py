"""Artifacts: the files of a design."""
