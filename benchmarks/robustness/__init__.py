"""What happens where something goes wrong: damaged files, wrong calls, kills.

``python -m benchmarks.robustness files|kills|native``: each takes some minutes at most, prints
how many it tried and what became of them, and ends with 1 if any went wrong.
"""
