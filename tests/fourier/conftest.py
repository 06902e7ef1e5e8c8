import pytest
from ways import WAYS, take


@pytest.fixture(params=WAYS)
def way(request, monkeypatch):
    """All ways of doing it."""
    take(request.param, monkeypatch)
    return request.param
