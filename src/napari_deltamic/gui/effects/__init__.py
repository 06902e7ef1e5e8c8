"""The choice of effects, and the evidence for them."""
