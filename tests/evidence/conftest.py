from tests.pipelines.conftest import no_tracking_server_is_chosen

__all__ = ["no_tracking_server_is_chosen"]
