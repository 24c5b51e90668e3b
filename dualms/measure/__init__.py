"""Figures of a body: geometry, channels, printing, and the report that collects them."""
