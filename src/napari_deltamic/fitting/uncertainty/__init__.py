"""What the end of a fit gives way to: other noise, more steps, another prior or model."""
