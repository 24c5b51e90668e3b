"""Domains: uploaded envelopes."""
