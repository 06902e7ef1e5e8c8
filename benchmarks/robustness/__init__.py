"""What happens where something goes wrong: wrong calls of the compiled functions.

``python -m benchmarks.robustness native``: each takes some minutes at most, prints
how many it tried and what became of them, and ends with 1 if any went wrong.
"""
