"""What an image calls for: evidence for effects, their cost, and what a fit left unexplained."""

from .recommend import Evidence, Recommendation, recommend, recommend_for
from .residual import Residual, analyse_residual

__all__ = [
    "Evidence",
    "Recommendation",
    "Residual",
    "analyse_residual",
    "recommend",
    "recommend_for",
]
