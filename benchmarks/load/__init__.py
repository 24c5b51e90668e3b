"""Load on the API: see :mod:`benchmarks.load.__main__`."""
