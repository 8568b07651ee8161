"""Evidence for the product's promises: fault injection, benchmarks, scaling runs and the results page.

Evidence may import everything; nothing imports evidence.
"""
