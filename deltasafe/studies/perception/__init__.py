"""The studies of section V-A: augmentation schemes (Tables I, II), ensemble size (Table III, Fig. 4), ablation.

`StudySettings` lists the cells, `study` trains and evaluates them, `tables` and `report` present the results. This
module imports neither torch nor OpenCV.
"""

from deltasafe.studies.perception.settings import Cell, StudySettings

__all__ = ["Cell", "StudySettings"]
