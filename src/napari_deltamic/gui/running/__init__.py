"""A fit in the background: the worker, what it streams, its panel, what is changed by hand."""
