"""Two builds of the package in one run: what a newer one gains in time, and what it costs."""
