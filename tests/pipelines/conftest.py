import os

import pytest

from pipelines.home import TRACKING_VARIABLE


@pytest.fixture(autouse=True)
def no_tracking_server():
    """Clear the address that MLflow writes to the environment, where it would look like a choice of the user."""
    os.environ.pop(TRACKING_VARIABLE, None)
    yield
    os.environ.pop(TRACKING_VARIABLE, None)
