"""The forecast of a fit whose settings were changed on the way."""

from __future__ import annotations

from dataclasses import dataclass

from ..fitting import FitState
from ..fitting.history import History
from .forecast import Forecast


@dataclass(frozen=True)
class RenewedForecast:
    """The forecast of a fit whose settings were changed on the way: it knows no time before.

    Attributes
    ----------
    forecast
        Of a whole fit with the new settings.
    iterations, seconds
        That the fit had taken when they were changed; s without pauses.
    """

    forecast: Forecast
    iterations: int
    seconds: float

    def remaining_seconds(
        self, history: History, state: FitState, elapsed: float | None = None
    ) -> float | None:
        """s until the fit has converged; None while nothing is known."""
        left = self.forecast.remaining_seconds(history, state)
        if left is None or elapsed is None:
            return left
        # Only the iterations since the change tell how far the new forecast is off.
        since = History(level=history.level[self.iterations :])
        plain = self.forecast.remaining_seconds(since, state)
        scaled = self.forecast.remaining_seconds(since, state, elapsed - self.seconds)
        return left * scaled / plain if plain and scaled is not None else left
