"""The studies of section V-A: compared schemes (Tables I, II), ensemble size (Table III, Fig. 4), ablation.

`StudySettings` says which cells there are, `Study` trains and judges them, `tables` and `writing` report.
Settings are at hand without torch; all else is imported from its module.
"""

from deltasafe.studies.perception.settings import Cell, StudySettings

__all__ = ["Cell", "StudySettings"]
