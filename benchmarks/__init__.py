"""Measurements: each can be run from the checkout, and says how in its docstring."""
