"""The arm model: MakeHuman's left arm (CC0) as quadrilaterals, bone weights, joints and shape targets."""

import dataclasses
import functools
import pathlib

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.io.storage import sha256_of_file
from generator.surface_mesh import Refinement, catmull_clark

__all__ = ["ARM_SHA256", "ArmModel"]

Array = NDArray[np.float64]
ARM_PATH = pathlib.Path(__file__).parent / "data" / "arm.npz"
ARM_SHA256 = "98866217b1fc4f38c468818b4366bab19951bc8ae01d601ce7b4d0fb249a7639"
REFINEMENTS = 3


@dataclasses.dataclass(frozen=True)
class ArmModel:
    """Points are mesh vertices first, then the helper vertices whose means are the joints; all move with the targets.

    Attributes:
        points_dm: (P, 3) points of the neutral body in decimetres.
        quads: (F, 4) faces over the first V points.
        weights: (V, B) share of each bone in each vertex; rows sum to one.
        bones: the B names of the bones.
        joints: slice of the points whose mean is the joint, by name.
        targets: (P, 3) displacement in decimetres of each shape target, by name.
        nails: (V,) 1 where there is a fingernail.
        refinements: the steps of Catmull-Clark from the coarse to the fine mesh.
    """

    points_dm: Array
    quads: NDArray[np.int64]
    weights: Array
    bones: tuple[str, ...]
    joints: dict[str, slice]
    targets: dict[str, Array]
    nails: Array
    refinements: tuple[Refinement, ...]

    @classmethod
    @functools.cache
    def load(cls) -> "ArmModel":
        """The packaged model.

        Raises:
            DataError: the file is missing or altered.
        """
        if not ARM_PATH.is_file() or sha256_of_file(ARM_PATH) != ARM_SHA256:
            raise DataError(ARM_PATH, "is missing or altered; restore it from the repository")
        with np.load(ARM_PATH, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file}
        quads, n_vertices = arrays["quads"].astype(np.int64), int(arrays["nmesh"])
        ends = n_vertices + np.cumsum(arrays["jlen"])
        joints = {
            str(name): slice(int(end - length), int(end))
            for name, end, length in zip(arrays["jn"], ends, arrays["jlen"], strict=True)
        }
        refinements: list[Refinement] = []
        for _ in range(REFINEMENTS):
            last = refinements[-1] if refinements else None
            refinements.append(
                catmull_clark(last.quads, last.matrix.shape[0]) if last else catmull_clark(quads, n_vertices)
            )
        return cls(
            points_dm=arrays["V"].astype(float),
            quads=quads,
            weights=arrays["W"].astype(float) / arrays["W"].astype(float).sum(axis=1, keepdims=True),
            bones=tuple(map(str, arrays["bones"])),
            joints=joints,
            targets={str(name): delta.astype(float) for name, delta in zip(arrays["tn"], arrays["T"], strict=True)},
            nails=arrays["nail"].astype(float),
            refinements=tuple(refinements),
        )

    @property
    def n_vertices(self) -> int:
        """Number of vertices of the coarse mesh."""
        return len(self.weights)

    def bone(self, name: str) -> int:
        """Column of ``weights`` that belongs to a bone."""
        return self.bones.index(name)

    def refine(self, values: Array, levels: int = REFINEMENTS) -> Array:
        """Values at the vertices of the mesh refined ``levels`` times, from values at those of the coarse mesh."""
        for refinement in self.refinements[:levels]:
            values = refinement.matrix @ values
        return values

    def refined_quads(self, levels: int = REFINEMENTS) -> NDArray[np.int64]:
        """Faces of the mesh refined ``levels`` times."""
        return self.refinements[levels - 1].quads if levels else self.quads
