"""A stage as pictures: radiance with subsurface scattering, and the exact share of hand in each pixel."""

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from generator.backend import load_mitsuba
from generator.stage import Ball, Box, Cylinder, Disk, Lamp, Material, Panel, Shape, SkinMesh, Stage
from generator.subsurface import SkinLayers, scatter
from generator.surface_mesh import triangles_of, vertex_normals

__all__ = ["Picture", "Renderer"]

Array = NDArray[np.float64]
Look = Literal["full", "specular", "albedo", "coverage"]
SKIN_SPECULAR = 0.35
COVERAGE_SAMPLES = 32
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


@dataclasses.dataclass(frozen=True)
class Picture:
    """Linear radiance (H, W, 3), and the share of hand (H, W) in each pixel, 0 to 1."""

    radiance: Array
    coverage: Array


class Renderer:
    """Turns stages into pictures; ``scalar_rgb`` gives the same bytes for the same stage and seed."""

    def __init__(self, variant: str = "scalar_rgb") -> None:
        self.variant = variant
        self._mi = load_mitsuba(variant)

    def render(self, stage: Stage, samples: int, seed: int) -> Picture:
        """Path-traced picture with ``samples`` paths a pixel."""
        coverage = self.coverage(stage, seed)
        full = self._trace(stage, "full", samples, "gaussian", {"type": "path", "max_depth": 5}, seed)[..., :3]
        if not (coverage > 0).any():
            return Picture(full, coverage)
        paths = {"type": "path", "max_depth": 3}
        specular = self._trace(stage, "specular", max(samples // 2, 16), "gaussian", paths, seed + 1)[..., :3]
        values = {"type": "aov", "aovs": "a:albedo,d:depth"}
        layers = self._trace(stage, "albedo", 16, "box", values, seed + 2)
        pixel_mm_at_1m = 1000 / stage.camera.fx
        skin = SkinLayers(specular, layers[..., -4:-1], layers[..., -1] * pixel_mm_at_1m, coverage)
        return Picture(scatter(full, skin), coverage)

    def coverage(self, stage: Stage, seed: int) -> Array:
        """Share of hand (H, W): the hand is the only emitter, all else is black, the filter is a box."""
        integrator = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}
        return self._trace(stage, "coverage", COVERAGE_SAMPLES, "box", integrator, seed)[..., 0]

    def _trace(self, stage: Stage, look: Look, samples: int, rfilter: str, integrator: dict, seed: int) -> Array:
        content: dict[str, Any] = {
            "type": "scene",
            "integrator": integrator,
            "sensor": self._sensor(stage, samples, rfilter),
        }
        for i, part in enumerate(stage.hand):
            content[f"hand{i}"] = self._skin(part, look)
        for i, cloth in enumerate(stage.cloths):
            surface = {"type": "twosided", "side": self._surface(cloth.material, look)}
            content[f"cloth{i}"] = self._mesh(cloth.vertices_m, cloth.quads, surface)
        for i, shape in enumerate(stage.shapes):
            content[f"shape{i}"] = self._shape(shape, look)
        if look != "coverage":
            turned = self._mi.ScalarTransform4f().rotate([0, 0, 1], stage.environment.turn_deg).rotate([1, 0, 0], 90)
            light = self._mi.Bitmap(np.ascontiguousarray(stage.environment.radiance, dtype=np.float32))
            content["environment"] = {"type": "envmap", "bitmap": light, "to_world": turned}
            for i, lamp in enumerate(stage.lamps):
                content[f"lamp{i}"] = self._lamp(lamp)
        scene = self._mi.load_dict(content, parallel=False)
        return np.array(self._mi.render(scene, seed=seed), dtype=float)

    def _sensor(self, stage: Stage, samples: int, rfilter: str) -> dict:
        camera = stage.camera
        pose = np.eye(4)  # Mitsuba's camera looks along z with x to the left and y up
        pose[:3, :3] = camera.world_from_camera_rotation * [-1, -1, 1]
        pose[:3, 3] = camera.position_m
        return {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "fov_axis": "x",
            "near_clip": 0.01,
            "to_world": self._mi.ScalarTransform4f(pose),
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "pixel_format": "rgb",
                "rfilter": {"type": rfilter},
            },
            "sampler": {"type": "independent", "sample_count": samples},
        }

    def _skin(self, part: SkinMesh, look: Look) -> Any:
        albedo, roughness = ({"type": "mesh_attribute", "name": f"vertex_{name}"} for name in ("albedo", "roughness"))
        shiny = {"type": "principled", "roughness": roughness, "specular": SKIN_SPECULAR}
        surfaces: dict[Look, dict[str, Any]] = {
            "full": {**shiny, "base_color": albedo},
            "specular": {**shiny, "base_color": {"type": "rgb", "value": 0.0}},
            "albedo": {"type": "diffuse", "reflectance": albedo},
            "coverage": BLACK,
        }
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}} if look == "coverage" else None
        attributes = {"albedo": part.albedo, "roughness": part.roughness}
        return self._mesh(part.vertices_m, part.quads, surfaces[look], attributes, emitter)

    def _mesh(
        self,
        vertices: Array,
        quads: NDArray[np.int64],
        surface: dict,
        attributes: dict[str, Array] | None = None,
        emitter: dict | None = None,
    ) -> Any:
        triangles = triangles_of(quads)
        properties = self._mi.Properties()
        properties["bsdf"] = self._mi.load_dict(surface)
        if emitter:
            properties["emitter"] = self._mi.load_dict(emitter)
        mesh = self._mi.Mesh("mesh", len(vertices), len(triangles), has_vertex_normals=True, props=properties)
        parameters = self._mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        parameters["vertex_normals"] = vertex_normals(vertices, quads).astype(np.float32).ravel()
        parameters["faces"] = triangles.astype(np.uint32).ravel()
        parameters.update()
        for name, values in (attributes or {}).items():
            mesh.add_attribute(f"vertex_{name}", 1 if values.ndim == 1 else 3, values.astype(np.float32).ravel())
        return mesh

    def _surface(self, material: Material, look: Look) -> dict:
        if look == "coverage":
            return BLACK
        colour: dict[str, Any] = {"type": "rgb", "value": list(material.colour)}
        if material.texture is not None:
            place = self._mi.ScalarTransform4f().translate([*material.shift, 0]).rotate([0, 0, 1], material.turn_deg)
            colour = {
                "type": "bitmap",
                "bitmap": self._mi.Bitmap(np.ascontiguousarray(material.texture, dtype=np.float32)),
                "raw": True,
                "wrap_mode": "mirror",
                "to_uv": place.scale([material.tiles, material.tiles, 1]),
            }
        return {
            "type": "principled",
            "base_color": colour,
            "roughness": material.roughness,
            "specular": material.specular,
        }

    def _shape(self, shape: Shape, look: Look) -> dict:
        at, surface = self._mi.ScalarTransform4f(), self._surface(shape.material, look)
        both = {"type": "twosided", "side": surface}
        match shape:
            case Box():
                place = at.translate(list(shape.centre_m)).rotate([0, 0, 1], shape.turn_deg).scale(list(shape.half_m))
                return {"type": "cube", "to_world": place, "bsdf": surface}
            case Cylinder():
                ends = {"p0": list(shape.start_m), "p1": list(shape.end_m)}
                return {"type": "cylinder", **ends, "radius": shape.radius_m, "bsdf": both}
            case Disk():
                return {
                    "type": "disk",
                    "to_world": at.translate(list(shape.centre_m)).scale(shape.radius_m),
                    "bsdf": both,
                }
            case Ball():
                return {"type": "sphere", "center": list(shape.centre_m), "radius": shape.radius_m, "bsdf": surface}
            case Panel():
                place = at.translate(list(shape.centre_m)).rotate([0, 0, 1], shape.turn_deg)
                place = place.rotate([1, 0, 0], 90) if shape.upright else place
                return {"type": "rectangle", "to_world": place.scale(shape.half_m), "bsdf": both}

    def _lamp(self, lamp: Lamp) -> dict:
        place = self._mi.ScalarTransform4f().look_at(
            origin=list(lamp.position_m), target=list(lamp.target_m), up=[0.123, 0.98, 0.1]
        )
        radiance = {"type": "rgb", "value": list(lamp.radiance)}
        return {
            "type": "rectangle",
            "to_world": place.scale(lamp.half_m),
            "emitter": {"type": "area", "radiance": radiance},
        }
