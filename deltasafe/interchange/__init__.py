"""MCAP, the log format of robotics viewers: scenes are read from it and written to it, and so are executions."""

from deltasafe.interchange.executions import export_execution, import_execution
from deltasafe.interchange.scenes import export_scene, import_scene

__all__ = ["export_execution", "export_scene", "import_execution", "import_scene"]
