"""The graph of the domain: sites, edges, weights (paper, section 4.1)."""
