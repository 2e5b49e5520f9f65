"""Read camera, scene and suite files.

Values are checked strictly (``width = "512"`` and ``width = true`` are mistakes, not 512 and 1), and every mistake
ends in one line: file, key, what was found, what was expected.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from horizonval.core import files
from horizonval.core.errors import MistakeCollector, UserError, excerpt, nearest
from horizonval.core.json_types import JsonObject
from horizonval.spec.base import Model, deep_merge
from horizonval.spec.camera import ALL_HEADS, CameraSpec
from horizonval.spec.expand import variants
from horizonval.spec.explain import explain, show, with_option
from horizonval.spec.files import Kind, find
from horizonval.spec.orbit import OrbitSpec
from horizonval.spec.prior import PriorFile, PriorSpec, is_climate_file
from horizonval.spec.requirement import Requirement
from horizonval.spec.scene import SceneSpec, SpacecraftPart
from horizonval.spec.suite import DatasetSpec, FigureSpec, Keep, ProgramSpec, RegressionSpec, StabilitySpec, SuiteSpec

M = TypeVar("M", bound=Model)

Fly = Callable[[OrbitSpec, JsonObject, int, str, str], tuple[list[JsonObject], str]]
"""From an orbit, the scene it is laid over, seed, name and place in the file to a partial scene for every sample."""

CAMERA_TABLES = ("camera", "platform", "optics", "band", "detector")
"""Tables of the camera file that a scene may change, as ``camera.detector.exposure_s``; a band by its name."""

MAX_FILE_BYTES = 8 * 1024 * 1024
"""No specification is larger, and reading takes a second per megabyte."""

_TOO_DEEP = re.compile(r"(?<![\w.\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){64}")
"""A key of that many parts: the parser's time goes with the square of their number."""


@dataclass(frozen=True)
class Case:
    """One frame of a suite: everything a render needs, with every default filled in.

    ``head``: the head that takes the frame, where the scene makes one for every head; all heads see the same clouds.
    ``estimators``: those of the suite that run on it, None for all. ``table``, ``variant`` and ``sample``: the table
    ``[[cases]]`` it comes from, its label there, and the number of the orbit's sample. ``doubt``: warning about the
    orbit.
    """

    scene: SceneSpec
    camera: CameraSpec
    head: str | None = None
    estimators: tuple[str, ...] | None = None
    table: str | None = None
    variant: str = ""
    sample: str = ""
    doubt: str = ""

    @property
    def name(self) -> str:
        """The scene's name, followed by ``.<head>`` where the scene stands for a frame of every head."""
        return self.scene_name if self.head is None else f"{self.scene_name}.{self.head}"

    @property
    def scene_name(self) -> str:
        """Name of the scene, under which the results of all its heads together go."""
        return self.scene.scene.name


@dataclass(frozen=True)
class Suite:
    """A suite with its frames resolved, in the file's order; other fields are those of the file's tables.

    ``study``: the frames are those of a trade study. ``options``: words of the command line that replaced keys.
    """

    name: str
    title: str
    estimators: tuple[str, ...]
    cases: tuple[Case, ...]
    source: str
    stability: StabilitySpec | None = None
    programs: tuple[ProgramSpec, ...] = ()
    keep: Keep = "all"
    time_limit_s: float = 60.0
    memory_limit_mb: int = 4096
    figures: tuple[FigureSpec, ...] = ()
    frames: int | None = None
    regression: RegressionSpec | None = None
    study: bool = False
    draws: int = 1
    seed: int = 0
    options: tuple[str, ...] = ()
    dataset: DatasetSpec | None = None
    requirements: tuple[Requirement, ...] = ()

    @property
    def estimators_key(self) -> str:
        """File and key that name the estimators, for errors."""
        return f"{self.source}: {'study' if self.study else 'suite'}.estimators"


def load_camera(path_or_name: str | Path, *, beside: Path | None = None, where: str = "") -> CameraSpec:
    """Read a camera file by path or shipped name; see :func:`horizonval.spec.files.find`."""
    path = find("camera", path_or_name, beside=beside, where=where)
    return validate(CameraSpec, read_camera_tables(path), str(path))


def load_scene(path_or_name: str | Path, head: str | None = None) -> tuple[SceneSpec, CameraSpec]:
    """Read a scene file and the camera it names; ``head`` replaces ``camera.head``.

    UserError: among other mistakes, the camera has several heads and not exactly one is chosen.
    """
    path, scene, camera = _read_scene(path_or_name, head)
    camera.chosen_head(scene.camera.head, where=_head_key(path, head))
    return scene, camera


def load_frames(path_or_name: str | Path, head: str | None = None) -> tuple[Case, ...]:
    """Read a scene file and return its frames: one, or where ``camera.head`` is ``"all"`` one for every head.

    Parameters and errors as for :func:`load_scene`.
    """
    path, scene, camera = _read_scene(path_or_name, head)
    if scene.camera.head is None:
        camera.chosen_head(None, where=_head_key(path, head))
    return _one_per_head(scene, camera, _head_key(path, head))


def _read_scene(path_or_name: str | Path, head: str | None) -> tuple[Path, SceneSpec, CameraSpec]:
    path = find("scene", path_or_name)
    scene, camera = Shelf(path).resolve(read_toml(path), inside="")
    return path, scene if head is None else _with_head(scene, head), camera


def _head_key(path: Path, head: str | None) -> str:
    return f"{path}: camera.head" if head is None else "--head"


def _with_head(scene: SceneSpec, head: str) -> SceneSpec:
    return scene.model_copy(update={"camera": scene.camera.model_copy(update={"head": head})})


def _one_per_head(scene: SceneSpec, camera: CameraSpec, where: str) -> tuple[Case, ...]:
    """Return one case, or one for each head where the scene asks for all of them or, of several, for none."""
    chosen = scene.camera.head
    if camera.head and chosen in (None, ALL_HEADS):
        return tuple(Case(_with_head(scene, head.name), camera, head.name) for head in camera.head)
    camera.chosen_head(chosen, where=where)
    return (Case(scene, camera),)


def load_suite(
    path_or_name: str | Path, *, fly: Fly | None = None, frames: int | None = None, seed: int | None = None
) -> Suite:
    """Read a suite file, lay every frame over the defaults, and load the cameras.

    A frame whose camera has several heads becomes one case for each of them unless it chooses one. The suite's seed is
    the default of every frame's ``scene.seed``. Estimators are checked by who runs them.

    Parameters
    ----------
    path_or_name : str or Path
    fly : callable, optional
        Makes samples of orbits; :func:`horizonval.suites.suite.load_suite` passes it.
    frames, seed : int, optional
        Replace ``suite.frames`` and ``suite.seed``.
    """
    path = find("suite", path_or_name)
    spec = validate(SuiteSpec, read_toml(path), str(path))
    if frames is not None:
        if spec.suite.frames is None:
            raise UserError(
                f"the suite {spec.suite.name!r} draws no share of a number of frames",
                where="--frames",
                expected="a suite with suite.frames, such as strict",
            )
        spec = spec.model_copy(update={"suite": with_option(spec.suite, "frames", frames, "--frames")})
    if seed is not None:
        spec = spec.model_copy(update={"suite": with_option(spec.suite, "seed", seed, "--seed")})
    given = {"--frames": frames, "--seed": seed}
    words = tuple(word for option, value in given.items() if value is not None for word in (option, str(value)))
    return replace(suite_of(spec, path, fly), options=words)


def suite_of(spec: SuiteSpec, path: Path, fly: Fly | None = None, *, places: Sequence[str] = ()) -> Suite:
    """Return the suite of a specification; other files lie next to ``path``. Errors as :func:`load_suite`.

    ``places``: what errors call the tables of cases, in place of ``cases[1] (name)``.
    """
    seeded = deep_merge({"scene": {"seed": spec.suite.seed}}, spec.defaults)
    shelf = Shelf(path)
    cases: list[Case] = []
    names: dict[str, str] = {}
    collector = MistakeCollector()
    with collector.caught():
        for inside, data, origin in _scenes(spec, path, seeded, fly, places):
            with collector.caught(inside):
                scene, camera = shelf.resolve(data, inside=inside)
                for case in _one_per_head(scene, camera, f"{path}: {inside}: camera.head"):
                    # Some systems do not tell names apart by the case of their letters.
                    key = case.name.casefold()
                    if key in names:
                        twice = f"two frames are named {case.name!r}"
                        twice += "" if names[key] == case.name else f" and {names[key]!r}, alike but for capitals"
                        raise UserError(twice, where=f"{path}: {inside}", fix="rename one")
                    names[key] = case.name
                    cases.append(replace(case, **origin))
    collector.tell()
    head = spec.suite
    return Suite(
        head.name,
        head.title,
        tuple(head.estimators),
        tuple(cases),
        str(path),
        spec.stability,
        tuple(spec.estimator),
        head.keep,
        head.time_limit_s,
        head.memory_limit_mb,
        tuple(spec.figure),
        spec.suite.frames,
        spec.regression,
        draws=head.draws,
        seed=head.seed,
        dataset=spec.dataset,
        requirements=tuple(spec.requirement),
    )


def _scenes(
    spec: SuiteSpec, path: Path, seeded: JsonObject, fly: Fly | None, places: Sequence[str]
) -> Iterator[tuple[str, JsonObject, JsonObject]]:
    """Yield the place in the file that makes a scene, the scene over the defaults, and what a case knows beside it."""
    for i, frame in enumerate(spec.frame, start=1):
        inside = f"frame[{i}] ({excerpt(frame['scene']['name'])})"
        chosen = _chosen_estimators(frame.get("estimators"), spec.suite.estimators, f"{path}: {inside}.estimators")
        plain = {key: frame[key] for key in frame if key != "estimators"}
        yield inside, deep_merge(seeded, plain), {"estimators": chosen}
    for i, table in enumerate(spec.cases, start=1):
        inside = places[i - 1] if places else f"cases[{i}] ({table.name})"
        chosen = _chosen_estimators(table.estimators, spec.suite.estimators, f"{path}: {inside}.estimators")
        for variant in variants(table, spec.suite.seed, f"{path}: {inside}", spec.suite.frames):
            whole = deep_merge(seeded, variant.scene)
            origin = {"estimators": chosen, "table": table.name, "variant": variant.label}
            if variant.orbit is None:
                scene = deep_merge(whole, {"scene": {"name": variant.name}})
                yield f"{inside}: {variant.name}", scene, origin
                continue
            if fly is None:
                raise ValueError("a suite with orbits is loaded with horizonval.suites.suite.load_suite")
            orbit = validate(OrbitSpec, variant.orbit, str(path), inside=f"{inside}.orbit")
            samples, doubt = fly(orbit, whole, spec.suite.seed, table.name, f"{path}: {inside}")
            digits = max(3, len(str(len(samples) - 1)))
            for number, sample in enumerate(samples):
                place = f"{number:0{digits}d}"
                name = f"{variant.name}_{place}"
                scene = deep_merge(deep_merge(whole, sample), {"scene": {"name": name}})
                yield f"{inside}: {name}", scene, {**origin, "sample": place, "doubt": doubt}


def _chosen_estimators(names: Any, known: Sequence[str], where: str) -> tuple[str, ...] | None:
    """Return the estimators of a frame or table in the suite's order, ``None`` for all."""
    if names is None:
        return None
    if not isinstance(names, list) or not names:
        raise UserError(f"found {show(names)}", where=where, expected=f"a list with some of {', '.join(known)}")
    for name in names:
        if name not in known:
            raise UserError(
                f"{show(name)} is not among the suite's",
                where=where,
                expected=f"some of {', '.join(nearest(str(name), known))}",
            )
    return tuple(name for name in known if name in names)


class Shelf:
    """The files that the scenes of one file name, each read once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cameras: dict[str, CameraSpec] = {}
        self._files: dict[tuple[Kind, str], Path] = {}

    def resolve(
        self, data: JsonObject, *, inside: str, camera: CameraSpec | None = None
    ) -> tuple[SceneSpec, CameraSpec]:
        """Return scene and camera of plain data; UserError names the file, the position ``inside`` and the key.

        ``camera`` in the data may hold tables of the camera file that change it. A camera that is passed replaces the
        file that ``camera.file`` names.
        """
        use = data.get("camera")
        changes = {key: use[key] for key in CAMERA_TABLES if key in use} if isinstance(use, Mapping) else {}
        if isinstance(use, Mapping) and changes:
            data = {**data, "camera": {key: value for key, value in use.items() if key not in changes}}
        scene = validate(SceneSpec, data, str(self._path), inside=inside)
        prefix = f"{self._path}: {inside}: " if inside else f"{self._path}: "
        if camera is None:
            camera = self._camera(scene.camera.file, changes, inside, prefix)
        if not camera.band:
            raise UserError(
                f"camera {scene.camera.file!r} has no spectral band",
                where=prefix + "camera.file",
                expected="at least one [[band]] in the camera file",
            )
        if scene.atmosphere.file is not None:
            found = self._find("atmosphere", scene.atmosphere.file, prefix + "atmosphere.file")
            scene = _with_atmosphere(scene, file=str(found.resolve()))
        if scene.atmosphere.profile_file is not None:
            where = prefix + "atmosphere.profile_file"
            file = _beside(self._path, scene.atmosphere.profile_file, "a profile (CSV or JSON)", where)
            scene = _with_atmosphere(scene, profile_file=file)
        if scene.prior is not None:
            scene = scene.model_copy(update={"prior": with_climate_file(scene.prior, self._path, prefix + "prior")})
        if scene.part:
            scene = scene.model_copy(update={"part": [self._part(part, prefix) for part in scene.part]})
        return scene, camera

    def _part(self, part: SpacecraftPart, prefix: str) -> SpacecraftPart:
        """Return a part whose file is named by its whole path."""
        if part.file is None:
            return part
        file = _beside(self._path, part.file, "a mesh: PLY, OBJ or glTF", f"{prefix}part ({part.name}).file")
        return part.model_copy(update={"file": file})

    def _find(self, kind: Kind, name: str, where: str) -> Path:
        if (kind, name) not in self._files:
            self._files[kind, name] = find(kind, name, beside=self._path.parent, where=where)
        return self._files[kind, name]

    def _camera(self, name: str, changes: JsonObject, inside: str, prefix: str) -> CameraSpec:
        key = json.dumps([name, changes], sort_keys=True, default=str)
        if key in self._cameras:
            return self._cameras[key]
        file = self._find("camera", name, prefix + "camera.file")
        data = read_camera_tables(file)
        if changes:
            # The file itself must be right before a change can be at fault.
            validate(CameraSpec, data, str(file))
            camera = validate(
                CameraSpec,
                changed_camera(data, changes, prefix),
                str(self._path),
                inside=f"{inside}: camera".removeprefix(": "),
            )
        else:
            camera = validate(CameraSpec, data, str(file))
        self._cameras[key] = camera
        return camera


def load_prior(path: str | Path) -> PriorSpec:
    """Read a file with a table ``[prior]``."""
    file = Path(path).expanduser()
    files.ensure_file(file, expected="a TOML file with a table [prior]")
    return with_climate_file(validate(PriorFile, read_toml(file), str(file)).prior, file, f"{file}: prior")


def with_climate_file(prior: PriorSpec, path: Path, where: str) -> PriorSpec:
    """Return a prior whose climate's file, if it names one, is named by its whole path; it lies beside ``path``."""
    if prior.climate is None or not is_climate_file(prior.climate):
        return prior
    file = _beside(path, prior.climate, "a profile (CSV or JSON) or a table (NPZ)", f"{where}.climate")
    return prior.model_copy(update={"climate": file})


def _beside(path: Path, name: str, expected: str, where: str) -> str:
    """Return the whole path of a file that another file names; a relative one starts from that file's folder."""
    file = path.parent / Path(name).expanduser()
    try:
        files.ensure_file(file, expected=expected)
    except UserError as e:
        raise e.inside(where) from e
    return str(file.resolve())


def changed_camera(camera: JsonObject, changes: JsonObject, prefix: str) -> JsonObject:
    """Return a camera file's data with a scene's changes; bands are changed by their names."""
    bands = changes.get("band")
    if not isinstance(bands, Mapping):
        return deep_merge(camera, changes)
    names = [band.get("name") for band in camera.get("band", [])]
    for name in bands:
        if name not in names:
            raise UserError(f"no band {name!r}", where=f"{prefix}camera.band", expected=", ".join(map(str, names)))
    new = [deep_merge(band, bands.get(band.get("name"), {})) for band in camera["band"]]
    return deep_merge(camera, {**changes, "band": new})


def read_camera_tables(path: Path) -> dict[str, Any]:
    """Return a camera file's tables; a scene, suite or study in its place is one mistake."""
    data = read_toml(path)
    use = data.get("camera")
    kind = next((kind for kind in ("scene", "suite", "study") if kind in data), None)
    if kind is not None or (isinstance(use, dict) and "file" in use):
        raise UserError(f"is a {kind or 'scene'}, and no camera", where=str(path), expected="a camera file")
    return data


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's tables; a syntax error names file, line and column."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected="a TOML file")
    if _TOO_DEEP.search(text):
        raise UserError("a key of 64 parts or more", where=str(path), expected="keys of a few parts, as camera.file")
    try:
        tables = tomllib.loads(text)
        _refuse_long_integers(tables, path, "")
        return tables
    except RecursionError as e:
        what = "nested too deeply"
        error: Exception = e
    except ValueError as e:
        what, error = _mistake_in_toml(str(e)), e
    raise UserError(
        f"not valid TOML: {what}", where=str(path), expected='lines such as key = 1.0 or key = "text"'
    ) from error


def _refuse_long_integers(value: object, file: Path, key: str) -> None:
    """Refuse an integer of more than TOML's 64 bits, which the models are not made for."""
    if isinstance(value, dict):
        for name, one in value.items():
            _refuse_long_integers(one, file, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for i, one in enumerate(value, start=1):
            _refuse_long_integers(one, file, f"{key}[{i}]")
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        expected = "a number between -2^63 and 2^63"
        raise UserError("an integer of more than 64 bits", where=f"{file}: {excerpt(key)}", expected=expected)


def _mistake_in_toml(message: str) -> str:
    """Return what the parser says of a mistake and its place, without what it quotes: the file may be no TOML at all.

    A single sign may stay.
    """
    if "integer string conversion" in message:
        return "a number of thousands of digits"
    what, _, place = message.rpartition(" (at ")
    place = f" (at {place}" if what else ""
    what = re.sub(r"^Cannot declare .* twice$", "Cannot declare the same table twice", what or message)
    what = re.sub(r"^(Cannot mutate immutable namespace|Duplicate inline table key) .*", r"\1", what)
    return re.sub(r"(['\"])(?!\1).{5,}\1", "...", what) + place


def validate(model: type[M], data: Mapping[str, Any], file: str, *, inside: str = "") -> M:
    """Return the model of plain data; a mistake becomes one line that names file and key."""
    try:
        return model.model_validate(data, strict=True)
    except ValidationError as e:
        raise explain(e, model, file, inside=inside) from e


def _with_atmosphere(scene: SceneSpec, **changes: str) -> SceneSpec:
    return scene.model_copy(update={"atmosphere": scene.atmosphere.model_copy(update=changes)})
