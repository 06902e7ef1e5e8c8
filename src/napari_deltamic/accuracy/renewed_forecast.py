"""The forecast of a fit whose settings were changed on the way."""

from __future__ import annotations

from dataclasses import dataclass

from ..fitting import FitState
from ..fitting.history import History
from .forecast import Forecast


@dataclass(frozen=True)
class RenewedForecast:
    """The forecast of a fit whose settings were changed on the way; it ignores the time before.

    Attributes
    ----------
    forecast
        Forecast of a whole fit with the new settings.
    iterations, seconds
        Iterations and time (s, without pauses) that the fit had taken when they were changed.
    """

    forecast: Forecast
    iterations: int
    seconds: float

    def remaining_seconds(
        self, history: History, state: FitState, elapsed: float | None = None
    ) -> float | None:
        """Seconds until the fit has converged; None while that is not known."""
        left = self.forecast.remaining_seconds(history, state)
        if left is None or elapsed is None:
            return left
        # Only the iterations since the change tell how far off the new forecast is.
        since = History(level=history.level[self.iterations :])
        plain = self.forecast.remaining_seconds(since, state)
        scaled = self.forecast.remaining_seconds(since, state, elapsed - self.seconds)
        return left * scaled / plain if plain and scaled is not None else left
