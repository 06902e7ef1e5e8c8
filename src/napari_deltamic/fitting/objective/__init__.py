"""The log posterior as it is posed, and the steps down it."""
