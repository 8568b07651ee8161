"""The arm model: MakeHuman's left arm (CC0) with bone weights, joints and shape targets."""

import dataclasses
import functools
import pathlib

import numpy as np

from deltasafe.errors import DataError
from deltasafe.io.storage import sha256_of_file
from generator.aliases import Array, Quads
from generator.surface_mesh import Refinement, catmull_clark

ARM_PATH = pathlib.Path(__file__).parent / "data" / "arm.npz"
ARM_SHA256 = "98866217b1fc4f38c468818b4366bab19951bc8ae01d601ce7b4d0fb249a7639"
N_REFINEMENTS = 3


@dataclasses.dataclass(frozen=True)
class ArmModel:
    """The neutral arm. The first V points are mesh vertices; the others are helper points that define the joints.

    Attributes:
        points_dm: (P, 3) points of the neutral body in decimeters.
        quads: (F, 4) faces over the first V points.
        weights: (V, B) skinning weight of each bone; rows sum to one.
        bones: names of the B bones.
        joints: by name, the slice of the points whose mean is the joint.
        targets: by name, the displacement (P, 3) in decimeters of each shape target.
        nails: (V,) 1 on fingernails, else 0.
        refinements: Catmull-Clark steps from the coarse to the fine mesh.
    """

    points_dm: Array
    quads: Quads
    weights: Array
    bones: tuple[str, ...]
    joints: dict[str, slice]
    targets: dict[str, Array]
    nails: Array
    refinements: tuple[Refinement, ...]

    @classmethod
    @functools.cache
    def load(cls) -> "ArmModel":
        """Load the packaged model.

        Raises:
            DataError: the file is missing or has another SHA-256 digest.
        """
        if not ARM_PATH.is_file() or sha256_of_file(ARM_PATH) != ARM_SHA256:
            raise DataError(ARM_PATH, "is missing or altered; restore it from the repository")
        with np.load(ARM_PATH, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file}
        quads, n_vertices = arrays["quads"].astype(np.int64), int(arrays["nmesh"])
        ends = (n_vertices + np.cumsum(arrays["jlen"])).tolist()
        weights = arrays["W"].astype(float)
        refinements = [catmull_clark(quads, n_vertices)]
        while len(refinements) < N_REFINEMENTS:
            refinements.append(catmull_clark(refinements[-1].quads, refinements[-1].matrix.shape[0]))
        return cls(
            points_dm=arrays["V"].astype(float),
            quads=quads,
            weights=weights / weights.sum(axis=1, keepdims=True),
            bones=tuple(arrays["bones"].tolist()),
            joints=dict(zip(arrays["jn"].tolist(), map(slice, [n_vertices, *ends], ends), strict=False)),
            targets=dict(zip(arrays["tn"].tolist(), arrays["T"].astype(float), strict=True)),
            nails=arrays["nail"].astype(float),
            refinements=tuple(refinements),
        )

    @property
    def n_vertices(self) -> int:
        """Number of vertices of the coarse mesh."""
        return len(self.weights)

    def bone_index(self, name: str) -> int:
        """Return the column of ``weights`` that belongs to a bone."""
        return self.bones.index(name)

    def refine(self, values: Array, levels: int = N_REFINEMENTS) -> Array:
        """Interpolate coarse vertex values (V, ...) to the mesh refined ``levels`` times."""
        for refinement in self.refinements[:levels]:
            values = refinement.matrix @ values
        return values

    def refined_quads(self, levels: int = N_REFINEMENTS) -> Quads:
        """Return the faces of the mesh refined ``levels`` times."""
        return self.refinements[levels - 1].quads if levels else self.quads
