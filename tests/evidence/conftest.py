from tests.pipelines.conftest import no_tracking_server

__all__ = ["no_tracking_server"]
