"""Import and export of scenes and executions as MCAP, the log format of robotics viewers; import of ROS 2 bags."""

from deltasafe.interchange.executions import export_execution, import_execution
from deltasafe.interchange.scene_import import ImportOptions, import_scene
from deltasafe.interchange.scenes import export_scene

__all__ = ["ImportOptions", "export_execution", "export_scene", "import_execution", "import_scene"]
