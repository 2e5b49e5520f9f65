"""Scene files: one camera, one pose, one planet, one instant, and parts of the spacecraft in view."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Angle, Fraction, FrameName, Listed, Model, PlainName, Positive, Vector, Whole, unit
from horizonval.spec.earth import Atmosphere, CloudLayer, Clouds, Earth, Moon, Night, SunOverride, Surface
from horizonval.spec.pose import Attitude, CameraUse, Platform
from horizonval.spec.prior import CalibrationSpec, PriorSpec

Material = Literal["white_paint", "black_paint", "solar_cell", "kapton_foil", "gold", "aluminium"]

_KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "mesh": (("file",), ("scale",)),
    "panel": (("width_m", "height_m"), ()),
    "disc": (("radius_m",), ()),
    "boom": (("radius_m", "from_m", "to_m"), ()),
    "baffle": (("radius_m", "length_m"), ("end_radius_m",)),
}
"""Keys of their own that shapes need, and those that they may have."""
_OWN_KEYS = sorted({key for needed, more in _KEYS.values() for key in needed + more})


class SpacecraftPart(Model):
    """Something of the spacecraft before the camera: a simple shape or a mesh, with a surface and a temperature.

    Lengths are counted from the camera's pupil, in the axes of `frame`. `yaw_deg`, `pitch_deg` and `roll_deg` turn
    these axes into the part's own, in this order, as a camera's mounting does; `position_m` is where the part's origin
    stands. Both sides of every surface are seen.
    """

    name: PlainName = "part"
    """Name of the part, for errors and the truth."""
    shape: Literal["mesh", "panel", "disc", "boom", "baffle"]
    """In the part's own axes: `panel`, a rectangle across z, `width_m` along x, `height_m` along y; `disc`, a circle
    across z; `boom`, a closed cylinder of `radius_m` between `from_m` and `to_m`; `baffle`, an open tube or cone round
    z, of `radius_m` at z = 0 and `end_radius_m` at z = `length_m`; `mesh`, what `file` holds.
    """
    frame: Literal["body", "cam"] = "body"
    """Whose axes: of the body, or of the camera (x right, y down, z along the boresight)."""
    position_m: Vector = (0.0, 0.0, 0.0)
    """The part's origin, from the camera."""
    yaw_deg: Angle = 0.0
    """Yaw of the part, about z."""
    pitch_deg: Angle = 0.0
    """Pitch of the part, about y."""
    roll_deg: Angle = 0.0
    """Roll of the part, about x."""
    width_m: Positive | None = None
    """Of a panel, along its x."""
    height_m: Positive | None = None
    """Of a panel, along its y."""
    radius_m: Positive | None = None
    """Of a disc, a boom, or a baffle at z = 0."""
    end_radius_m: Positive | None = None
    """Of a baffle at its other end; without the key `radius_m`, a tube."""
    length_m: Positive | None = None
    """Of a baffle, along z."""
    from_m: Vector | None = None
    """Middle of a boom's first end, in the part's own axes."""
    to_m: Vector | None = None
    """Middle of a boom's other end."""
    file: str | None = None
    """A mesh: PLY, OBJ or glTF (`.gltf`, `.glb`); a relative path starts from the folder of this file. Its triangles
    are taken as they are, without textures."""
    scale: Annotated[Positive, unit("m")] | None = None
    """Metres per unit of a mesh file; 1 without the key."""
    material: Material = "white_paint"
    """The surface by name: reflectance over wavelength, and emissivity."""
    bsdf: dict[str, Any] | None = None
    """A BSDF of Mitsuba in place of the material's, such as `{ type = "diffuse", reflectance = 0.5 }`: the same at all
    wavelengths, and without files.
    """
    emissivity: Fraction | None = None
    """In thermal bands, the same in all directions; without the key the material's."""
    temperature_k: Annotated[float, Field(ge=0, le=2000)] = 293.15
    """In thermal bands."""

    @model_validator(mode="after")
    def _keys_of_the_shape(self) -> SpacecraftPart:
        needed, more = _KEYS[self.shape]
        for key in _OWN_KEYS:
            given = getattr(self, key) is not None
            if key in needed and not given:
                raise ValueError(f'shape = "{self.shape}" needs {key}')
            if given and key not in needed + more:
                raise ValueError(f'{key} does not go with shape = "{self.shape}"')
        if self.shape == "boom" and self.from_m == self.to_m:
            raise ValueError("from_m and to_m are the same point")
        if self.bsdf is not None and not isinstance(self.bsdf.get("type"), str):
            raise ValueError('bsdf needs type, the name of a BSDF of Mitsuba such as "diffuse"')
        return self


class SceneName(Model):
    """Identity of the scene; the seed of everything random is a hash of it."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"draw"})

    name: FrameName = "scene"
    """Name of the scene. Clouds are drawn from it, unless there is a `draw`; with all the rest of scene and camera it
    also seeds the noise.
    """
    seed: Whole = 0
    """Another number draws other clouds and other noise. In a suite the default is the suite's seed."""
    draw: FrameName | None = None
    """A name from which everything random is drawn, instead of the scene's identity. Scenes of the same draw and
    seed have the same clouds and, with the same camera name, the same noise: for comparisons frame by frame."""


class RenderSettings(Model):
    """Accuracy of a frame.

    With 128 nodes the march is within 0.3 % of its limit in pixels brighter than a twentieth of the brightest, and
    within 1 % (1.5 % with particles) down to a thousandth, with the Sun at any height to 8 deg below the horizon.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"method", "accuracy", "part_samples"})

    method: Literal["table", "march"] = "table"
    """How sunlight is computed in solar bands. `table` tabulates it over direction, once for all frames of one position
    and Sun, and interpolates. `march` follows the ray of every cell: the reference for the tables, at many times their
    cost. Thermal bands always use tables.
    """
    accuracy: Annotated[float, Field(ge=1e-5, le=0.1), unit("1")] = 1e-3
    """Error that tables of radiance may have, as a share of the radiance of the frame's bright limb: 1e-2 for drafts,
    1e-4 for references. It sets their resolution; the march along every cell's ray does not use it.
    """
    subsamples: Annotated[int, Field(ge=1, le=16), unit("1")] = 2
    """Rays per pixel along each axis, to average the soft limb; the ground's share of a pixel is exact. With pixels 16
    km wide the error is up to 10, 2.8, 1.2 and 0.8 % of the brightest with 1, 2, 3 and 4, with 5 km 1.0 and 0.3 %
    with 1 and 2.
    """
    nodes: Annotated[int, Field(ge=8, le=4096), unit("1")] = 128
    """Points along each ray at which air is looked up."""
    orders: Literal["single", "all"] = "all"
    """Orders of scattering of sunlight: `single`, or `all`."""
    part_samples: Annotated[int, Field(ge=1, le=4096), unit("1")] = 64
    """Random rays per pixel on parts of the spacecraft, rounded up to a square, for the light of the Earth on them.
    """
    band_error: Annotated[float, Field(ge=1e-4, le=0.1), unit("1")] = 0.012
    """Largest relative error of a solar band's radiance that too few wavelengths may leave. It gives the number of
    wavelengths of a band without `nodes` in the camera file: 4 for 450 to 750 nm and 1.2 %, 6 for 0.3 %, at twice the
    time.
    """


class SceneSpec(Model):
    """One scene file: one camera, one pose, one planet, one instant."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"layer", "part", "prior", "calibration"})

    scene: SceneName = SceneName()
    """Name and seed."""
    camera: CameraUse
    """Which camera, and its mounting. Every table of the camera file can be changed in place:
    `camera.detector.exposure_s`, and a band by its name, `camera.band.<name>.lo_um`.
    """
    platform: Platform
    """Where the satellite is."""
    attitude: Attitude = Attitude()
    """How the body is turned."""
    earth: Earth = Earth()
    """Shape of the planet."""
    atmosphere: Atmosphere = Atmosphere()
    """The air."""
    surface: Surface = Surface()
    """The ground."""
    clouds: Clouds | None = None
    """Clouds; none without this table."""
    layer: Annotated[tuple[CloudLayer, ...], Listed] = ()
    """Layers of thin cloud, as many `[[layer]]` tables as there are layers."""
    sun: SunOverride | None = None
    """The Sun placed by hand."""
    moon: Moon = Moon()
    """The Moon."""
    night: Night = Night()
    """Light of the night."""
    part: list[SpacecraftPart] = []
    """Parts of the spacecraft in view, each a table `[[part]]`."""
    render: RenderSettings = RenderSettings()
    """Accuracy of the rendering."""
    prior: PriorSpec | None = None
    """What estimators are given; without the table the planet's shape and the camera file. It changes neither frame nor
    noise.
    """
    calibration: CalibrationSpec | None = None
    """Errors of the camera and the time that estimators are given. It changes neither frame nor noise."""

    @model_validator(mode="after")
    def _layers_float_in_air(self) -> SceneSpec:
        air = self.atmosphere
        if self.layer and (air.file is not None or (air.profile == "none" and air.profile_file is None)):
            raise ValueError('layer needs air with a profile, not atmosphere.file or profile = "none"; leave one out')
        return self
