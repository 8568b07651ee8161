"""Rendering of a stage with Mitsuba: radiance with subsurface scattering, and the fraction of hand in each pixel."""

import dataclasses
from typing import Any, Literal

import numpy as np

from generator.aliases import Array, Quads
from generator.backend import load_mitsuba
from generator.stage import Box, Cylinder, Disk, Lamp, Material, Panel, Shape, SkinMesh, Sphere, Stage
from generator.subsurface import SkinBuffers, scatter
from generator.surface_mesh import triangulate, vertex_normals

Pass = Literal["full", "specular", "albedo", "coverage"]
SKIN_SPECULAR = 0.35
MIN_SPECULAR_SAMPLES, ALBEDO_SAMPLES, COVERAGE_SAMPLES = 16, 16, 32
ALBEDO_CHANNELS, DEPTH_CHANNEL = slice(-4, -1), -1  # AOVs are the last channels


def _rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": value}


BLACK = {"type": "diffuse", "reflectance": _rgb(0.0)}


@dataclasses.dataclass(frozen=True)
class Picture:
    """Linear radiance (H, W, 3), and the fraction of hand in each pixel (H, W)."""

    radiance: Array
    coverage: Array


class Renderer:
    """Path tracer for stages; the variant ``scalar_rgb`` gives the same bytes for the same stage and seed."""

    def __init__(self, variant: str = "scalar_rgb") -> None:
        self._mi = load_mitsuba(variant)

    def render(self, stage: Stage, samples: int, seed: int) -> Picture:
        """Render a picture with ``samples`` paths per pixel."""
        coverage = self.coverage(stage, seed)
        full = self._trace(stage, "full", samples, "gaussian", {"type": "path", "max_depth": 5}, seed)[..., :3]
        if not (coverage > 0).any():
            return Picture(full, coverage)
        path = {"type": "path", "max_depth": 3}
        n_specular = max(samples // 2, MIN_SPECULAR_SAMPLES)
        specular = self._trace(stage, "specular", n_specular, "gaussian", path, seed + 1)[..., :3]
        aov = {"type": "aov", "aovs": "a:albedo,d:depth"}
        channels = self._trace(stage, "albedo", ALBEDO_SAMPLES, "box", aov, seed + 2)
        albedo, depth_m = channels[..., ALBEDO_CHANNELS], channels[..., DEPTH_CHANNEL]
        pixel_mm_at_1m = 1000 / stage.camera.fx
        skin = SkinBuffers(specular, albedo, depth_m * pixel_mm_at_1m, coverage)
        return Picture(scatter(full, skin), coverage)

    def coverage(self, stage: Stage, seed: int) -> Array:
        """Render the fraction of hand (H, W) with a box filter; the hand is the only emitter and the rest is black."""
        integrator = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}
        return self._trace(stage, "coverage", COVERAGE_SAMPLES, "box", integrator, seed)[..., 0]

    def _trace(self, stage: Stage, render_pass: Pass, samples: int, rfilter: str, integrator: dict, seed: int) -> Array:
        sensor = self._sensor(stage, samples, rfilter)
        content: dict[str, Any] = {"type": "scene", "integrator": integrator, "sensor": sensor}
        for i, part in enumerate(stage.hand):
            content[f"hand{i}"] = self._skin(part, render_pass)
        if sleeve := stage.sleeve:
            bsdf = {"type": "twosided", "side": self._bsdf(sleeve.material, render_pass)}
            content["sleeve"] = self._mesh(sleeve.vertices_m, sleeve.quads, bsdf)
        for i, shape in enumerate(stage.shapes):
            content[f"shape{i}"] = self._shape(shape, render_pass)
        if render_pass != "coverage":
            environment = stage.environment
            to_world = self._mi.ScalarTransform4f().rotate([0, 0, 1], environment.rotation_deg).rotate([1, 0, 0], 90)
            bitmap = self._mi.Bitmap(np.ascontiguousarray(environment.radiance, dtype=np.float32))
            content["environment"] = {"type": "envmap", "bitmap": bitmap, "to_world": to_world}
            content["lamp"] = self._lamp(stage.lamp)
        scene = self._mi.load_dict(content, parallel=False)
        return np.array(self._mi.render(scene, seed=seed), dtype=float)

    def _sensor(self, stage: Stage, samples: int, rfilter: str) -> dict:
        camera = stage.camera
        pose = np.eye(4)  # Mitsuba's camera looks along z, with x to the left and y up
        pose[:3, :3] = camera.world_from_camera_rotation * [-1, -1, 1]
        pose[:3, 3] = camera.position_m
        size = {"width": camera.width, "height": camera.height}
        return {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "fov_axis": "x",
            "near_clip": 0.01,
            "to_world": self._mi.ScalarTransform4f(pose),
            "film": {"type": "hdrfilm", **size, "pixel_format": "rgb", "rfilter": {"type": rfilter}},
            "sampler": {"type": "independent", "sample_count": samples},
        }

    def _skin(self, part: SkinMesh, render_pass: Pass) -> Any:
        albedo, roughness = ({"type": "mesh_attribute", "name": f"vertex_{name}"} for name in ("albedo", "roughness"))
        principled = {"type": "principled", "roughness": roughness, "specular": SKIN_SPECULAR}
        bsdfs: dict[Pass, dict[str, Any]] = {
            "full": {**principled, "base_color": albedo},
            "specular": {**principled, "base_color": _rgb(0.0)},
            "albedo": {"type": "diffuse", "reflectance": albedo},
            "coverage": BLACK,
        }
        emitter = {"type": "area", "radiance": _rgb(1.0)} if render_pass == "coverage" else None
        mesh = self._mesh(part.vertices_m, part.quads, bsdfs[render_pass], emitter)
        mesh.add_attribute("vertex_albedo", 3, part.albedo.astype(np.float32).ravel())
        mesh.add_attribute("vertex_roughness", 1, part.roughness.astype(np.float32))
        return mesh

    def _mesh(self, vertices: Array, quads: Quads, bsdf: dict, emitter: dict | None = None) -> Any:
        triangles = triangulate(quads)
        properties = self._mi.Properties()
        properties["bsdf"] = self._mi.load_dict(bsdf)
        if emitter:
            properties["emitter"] = self._mi.load_dict(emitter)
        mesh = self._mi.Mesh("mesh", len(vertices), len(triangles), has_vertex_normals=True, props=properties)
        parameters = self._mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        parameters["vertex_normals"] = vertex_normals(vertices, quads).astype(np.float32).ravel()
        parameters["faces"] = triangles.astype(np.uint32).ravel()
        parameters.update()
        return mesh

    def _bsdf(self, material: Material, render_pass: Pass) -> dict:
        if render_pass == "coverage":
            return BLACK
        color = _rgb(list(material.color))
        if material.texture is not None:
            to_uv = self._mi.ScalarTransform4f().translate([*material.uv_offset, 0])
            to_uv = to_uv.rotate([0, 0, 1], material.uv_rotation_deg).scale([material.repeats, material.repeats, 1])
            bitmap = self._mi.Bitmap(np.ascontiguousarray(material.texture, dtype=np.float32))
            color = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "mirror", "to_uv": to_uv}
        shading = {"roughness": material.roughness, "specular": material.specular}
        return {"type": "principled", "base_color": color, **shading}

    def _shape(self, shape: Shape, render_pass: Pass) -> dict:
        transform, bsdf = self._mi.ScalarTransform4f(), self._bsdf(shape.material, render_pass)
        both_sides = {"type": "twosided", "side": bsdf}
        match shape:
            case Box():
                to_world = transform.translate(list(shape.center_m)).rotate([0, 0, 1], shape.rotation_deg)
                return {"type": "cube", "to_world": to_world.scale(list(shape.half_size_m)), "bsdf": bsdf}
            case Cylinder():
                ends = {"p0": list(shape.start_m), "p1": list(shape.end_m)}
                return {"type": "cylinder", **ends, "radius": shape.radius_m, "bsdf": both_sides}
            case Disk():
                to_world = transform.translate(list(shape.center_m)).scale(shape.radius_m)
                return {"type": "disk", "to_world": to_world, "bsdf": both_sides}
            case Sphere():
                return {"type": "sphere", "center": list(shape.center_m), "radius": shape.radius_m, "bsdf": bsdf}
            case Panel():
                to_world = transform.translate(list(shape.center_m)).rotate([0, 0, 1], shape.rotation_deg)
                to_world = to_world.rotate([1, 0, 0], 90) if shape.vertical else to_world
                return {"type": "rectangle", "to_world": to_world.scale(shape.half_size_m), "bsdf": both_sides}

    def _lamp(self, lamp: Lamp) -> dict:
        # the up vector is an arbitrary direction that is unlikely to be parallel to the lamp's axis
        to_world = self._mi.ScalarTransform4f().look_at(
            origin=list(lamp.position_m), target=list(lamp.target_m), up=[0.123, 0.98, 0.1]
        )
        emitter = {"type": "area", "radiance": _rgb(list(lamp.radiance))}
        return {"type": "rectangle", "to_world": to_world.scale(lamp.half_size_m), "emitter": emitter}
