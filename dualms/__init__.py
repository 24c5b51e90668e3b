"""The science of DualMS: from an envelope and its ports to a certified two-fluid exchanger."""

__version__ = "0.1.0"
