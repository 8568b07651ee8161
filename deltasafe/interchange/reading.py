"""Reading of logs: MCAP files, and ROS 2 bags in both of their storages."""

import pathlib

from deltasafe.errors import DataError, DeltasafeError
from deltasafe.interchange.log_content import LogBuilder, LogContent
from deltasafe.interchange.mcap_log import add_mcap
from deltasafe.interchange.ros_bag import add_bag
from deltasafe.io.arrays import READ_ERRORS


def read_log(path: str | pathlib.Path, image_after_s: float = 0.0) -> LogContent:
    """Read an MCAP file, a folder that ``ros2 bag record`` wrote, or its database (.db3).

    Messages in JSON are read, and those in CDR whose types a scene needs. Others are skipped.

    Args:
        image_after_s: of each topic of images, keep the first image at least this long after the topic's first one.

    Raises:
        DataError: the log is missing, truncated, damaged, or of another format.
        SettingsError: the package mcap or rosbags is needed and not installed.
    """
    path = pathlib.Path(path)
    builder = LogBuilder(path, image_after_s)
    try:
        for part in _parts(path):
            (add_bag if part.is_dir() or part.suffix == ".db3" else add_mcap)(part, builder)
        return builder.content()
    except DeltasafeError:
        raise
    except FileNotFoundError:
        raise DataError(path, "is missing; give the log's file or folder") from None
    except (*READ_ERRORS, AttributeError) as error:
        raise DataError(path, f"is not a readable log ({error!r:.300}); record or export it again") from error


def _parts(path: pathlib.Path) -> list[pathlib.Path]:
    """The files of MCAP that make up a log, or the bag itself."""
    if path.is_dir():
        for part in path.iterdir():
            if not part.is_file():  # reading a pipe would block
                raise DataError(path, f"holds {part.name}, which is not a file; restore or remove it")
        parts = sorted(path.glob("*.mcap"))
        if not parts and not (path / "metadata.yaml").is_file():
            raise DataError(path, "holds neither metadata.yaml nor .mcap; give the folder that `ros2 bag record` wrote")
        return parts or [path]
    if path.exists() and not path.is_file():
        raise DataError(path, "is not a file; give the log's file or folder")
    if path.suffix == ".bag":
        raise DataError(path, "is a bag of ROS 1; convert it with `rosbags-convert --src BAG --dst FOLDER`")
    return [path]
