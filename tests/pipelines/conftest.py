import os

import pytest

from pipelines.home import TRACKING_VARIABLE


@pytest.fixture(autouse=True)
def no_tracking_server_is_chosen():
    """MLflow writes each address that it is given to the environment, where it would pass for a user's choice."""
    os.environ.pop(TRACKING_VARIABLE, None)
    yield
    os.environ.pop(TRACKING_VARIABLE, None)
