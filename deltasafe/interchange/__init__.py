"""Import and export of scenes and executions as MCAP, the log format of robotics viewers."""

from deltasafe.interchange.executions import export_execution, import_execution
from deltasafe.interchange.scenes import export_scene, import_scene

__all__ = ["export_execution", "export_scene", "import_execution", "import_scene"]
