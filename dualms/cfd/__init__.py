"""Solved pressure drop and heat transfer of a design: quick runs on voxels, for ranking."""
