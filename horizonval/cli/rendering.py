"""Scenes to frames, pictures or Mitsuba files, and the integrator alone."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from horizonval.cli.options import SceneName, shipped
from horizonval.cli.output import check_target, written
from horizonval.core import files
from horizonval.core.errors import UserError

if TYPE_CHECKING:
    from horizonval import Frame


def render(
    scene: SceneName,
    out: Annotated[Path, typer.Option("-o", "--out", help="The frame, an EXR file.")],
    reference: Annotated[bool, typer.Option("--reference", help="By Monte Carlo, in stock Mitsuba.")] = False,
    spp: Annotated[
        int | None, typer.Option(min=2, max=1_000_000, help="With --reference: samples per pixel and node.")
    ] = None,
    reference_size: Annotated[
        str | None, typer.Option(metavar="WxH", help="With --reference: the image in fewer, larger pixels.")
    ] = None,
    head: Annotated[
        str | None, typer.Option(help="Of a camera with several heads: a name, or all of them (`all`).")
    ] = None,
) -> None:
    """Render one frame: radiance, truth maps, header.

    Of a camera with several heads, the one that the scene or --head names; `all` writes FRAME.<head>.exr for each.

    --reference is the cross-check: stock Mitsuba's Monte Carlo with the scene's orders of scattering by molecules and
    particles, ozone, and a uniform Lambert ground; in thermal bands emitting air and ground, by a separate integrator
    for Mitsuba. Without refraction, the Sun's disc and glare, surface map (in sunlight) and clouds. The file includes
    the standard error.
    """
    import horizonval as hv

    if not reference:
        if spp is not None or reference_size is not None:
            raise UserError("used without --reference", where="--spp" if spp is not None else "--reference-size")
        scenes = hv.Scene.each_head(scene, head)
        names = [single.spec.camera.head for single in scenes]
        targets = [out] if len(scenes) == 1 else [out.with_name(f"{out.stem}.{name}{out.suffix}") for name in names]
        for target in targets:
            check_target(target)
        for single, target in zip(scenes, targets, strict=True):
            start = time.perf_counter()
            _write_frame(target, hv.render(single), start)
        return
    source = hv.Scene.from_file(scene, head)
    check_target(out)
    size = None if reference_size is None else _size(reference_size, "--reference-size")
    start = time.perf_counter()
    try:
        frame = hv.render_reference(source, samples=spp, size=size)
    except UserError as e:
        if e.where != "size":
            raise
        raise UserError(e.what, where="--reference-size", expected=e.expected, fix=e.fix) from e
    _write_frame(out, frame, start)
    noise = ", ".join(f"{band} {100 * e:.2g} %" for band, e in frame.render["relative_standard_error"].items())
    print(f"standard error of a lit pixel: {noise} ({frame.render['spp']} samples)")
    for band, by in frame.render.get("deterministic_frame_differs", {}).items():
        print(
            f"{band}: without --reference and what is left out {by['mean']:+.1f} standard errors of the mean,", end=" "
        )
        print(f"{by['rms']:.2f} rms in a lit pixel")
    print(f"holds: {frame.render['holds']}\nleaves out: {frame.render['leaves_out']}")


def mitsuba(
    scene: SceneName,
    out: Annotated[Path, typer.Option("-o", "--out", help="A new or empty folder.")],
    head: Annotated[str | None, typer.Option(help="Of a camera with several heads, the name of one.")] = None,
) -> None:
    """Write a scene as files that Mitsuba opens.

    scene.xml is the deterministic frame and needs this package's plugins; reference.xml needs nothing but Mitsuba 3.
    """
    import horizonval as hv

    source = hv.Scene.from_file(scene, head)
    files.check_folder(out)
    from horizonval.renderer.reference.reference import export_scene

    for path in export_scene(source.spec, source.camera.spec, out):
        print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")


def radiance(
    rays: Annotated[Path, typer.Argument(help="CSV: obs_x_km .. obs_z_km, dir_x .. dir_z, sun_x .. sun_z.")],
    atmosphere: Annotated[str, typer.Option(help="Atmosphere file (JSON), or the name of a shipped one.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="CSV: the input and one column per band.")],
    orders: Annotated[str, typer.Option(help="Orders of scattering: single or all.")] = "single",
    thermal: Annotated[bool, typer.Option("--thermal", help="Emission instead of scattered sunlight.")] = False,
    refraction: Annotated[
        bool, typer.Option("--refraction", help="Bend light by the atmosphere file's `refractivity`.")
    ] = False,
) -> None:
    """Radiance along given rays in a given atmosphere: the integrator alone.

    1/sr for unit solar irradiance; with --thermal W m-2 sr-1 um-1 at each band's wavelength.
    """
    from horizonval.api.frame import radiance as along_rays
    from horizonval.formats.rays import write_radiance

    check_target(out, rays, atmosphere)
    table, values = along_rays(rays, atmosphere, orders=orders, thermal=thermal, refraction=refraction)
    with written(out) as path:
        write_radiance(path, table, values)
    print(f"{out}: {len(table.rows)} rays, bands {', '.join(values)}")


def gallery(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENE]...", help="Shipped scenes; all by default.", autocompletion=shipped("scene")),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the page; created if missing.")] = Path("gallery"),
) -> None:
    """Pictures of the shipped scenes on one page: in colour, or as brightness temperatures in the infrared."""
    from horizonval.api.gallery import make_gallery

    print(f"gallery: {make_gallery(out, scenes or [])}")


def _write_frame(out: Path, frame: Frame, start: float) -> None:
    with written(out) as path:
        frame.save(path)
    height, width = next(iter(frame.radiance.values())).shape
    counts = frame.render.get("spectral_nodes", {})
    bands = ", ".join(f"{band} ({counts[band]} spectral nodes)" if band in counts else band for band in frame.radiance)
    print(f"{out}: {width} x {height}, bands {bands}, {time.perf_counter() - start:.1f} s")


def _size(text: str, where: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    sides = [int(side) for side in (width, height) if re.fullmatch("[0-9]{1,5}", side)]
    if len(sides) != 2 or not all(1 <= side <= 16384 for side in sides):
        expected = "WIDTHxHEIGHT in pixels, such as 64x64, each from 1 to 16384"
        raise UserError(f"found {text[:40]!r}", where=where, expected=expected)
    return sides[0], sides[1]
