"""Parts of the spacecraft in a scene file: what hangs into the picture."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Angle, Finite, Fraction, Listed, PlainName, Positive
from horizonval.spec.units import unit

Material = Literal["white_paint", "black_paint", "solar_cell", "kapton_foil", "gold", "aluminium"]

Place = Annotated[tuple[Finite, Finite, Finite], Listed]

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
    position_m: Place = (0.0, 0.0, 0.0)
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
    from_m: Place | None = None
    """Middle of a boom's first end, in the part's own axes."""
    to_m: Place | None = None
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
