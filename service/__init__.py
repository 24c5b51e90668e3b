"""The face of DualMS: HTTP service, command line and Python client."""
