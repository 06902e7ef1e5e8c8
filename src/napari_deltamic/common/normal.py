"""Constants of the normal distribution."""

# Standard deviation over the median distance from the median, which a few outliers do not change:
# the inverse of the standard normal's upper quartile, 0.67449.
SIGMA_PER_MEDIAN_DEVIATION = 1.4826

# The median of the square of a standard normal: the square of its upper quartile.
MEDIAN_SQUARE = 0.4549
