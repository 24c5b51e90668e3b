"""Designs: the jobs that turn a domain and a specification into a heat exchanger."""
