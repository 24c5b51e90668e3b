"""The commands of ``dualms``, by what they are for."""
