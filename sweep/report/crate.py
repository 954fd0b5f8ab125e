"""Export of a study as a Process Run Crate (an RO-Crate): rows, plan, configuration, pictures."""

import contextlib
import io
import mimetypes
import struct
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from importlib.machinery import all_suffixes
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any

from sweep.core import project
from sweep.core.errors import InputError
from sweep.core.files import digest_file, path_inside_folder, printable_name, write_atomically
from sweep.core.version import VERSION
from sweep.report.page import run_dates
from sweep.runs import manifest, store
from sweep.runs.results import Results

if TYPE_CHECKING:
    from rocrate.rocrate import ROCrate

PYPI = "https://pypi.org/project"
CRATE_PROFILE = "https://w3id.org/ro/wfrun/process/0.5"
STUDY_FOLDER, PROJECT_FOLDER = (
    "study",
    "project",
)  # folders of the crate: a study's again, and what its system is read from
PICTURE_FILES = ("report.html", "map.png", "map.svg", "draws.png", "draws.svg")  # where the study's folder has them
# ends of files that can be imported, or are evaluated as networks
CODE_SUFFIXES = (*all_suffixes(), ".onnx", ".pt", ".pth", ".jit", ".pt2")
ENCRYPTED_FLAG = 1  # bit of a ZIP entry's flags
# an archive may unpack to SMALL bytes; to more only up to DENSEST times its size, and never beyond LARGEST
ALWAYS_ALLOWED_BYTES, MAX_UNPACKED_BYTES, MAX_COMPRESSION_RATIO, MAX_FILES = 100 * 2**20, 64 * 2**30, 100, 100_000
FILE_MEANINGS = {
    store.STUDY_FILE: "the resolved configuration, versions of the libraries, commit, devices",
    store.POINTS_FILE: "the points: one row for each rollout",
    manifest.MANIFEST_FILE: "length and SHA-256 of each file of rows",
    store.LOG_FILE: "time and machine of each finished batch",
    "report.html": "the page: map, filters, replays",
}


def write_crate(results: Results, out: Path, license_: str, zipped: bool, author: str = "") -> Path:
    """Write a study as an RO-Crate: its data with metadata, in a folder or an archive.

    Args:
        results: study with its folder.
        out: new or empty folder; the archive is `out`.zip.
        license_: address of the licence of the data.
        zipped: whether to write an archive instead of a folder.
        author: who ran the study; empty: not said.

    Returns:
        The folder or the archive.

    Raises:
        InputError: `rocrate` is not installed, `out` is not empty, or `license_` is no address.
    """
    try:
        from rocrate.rocrate import ROCrate
    except ModuleNotFoundError:
        raise InputError("--crate needs rocrate: pip install 'insect-sweep[crate]'") from None
    if not license_.startswith("https://"):
        raise InputError(
            f"--license = {license_} is not allowed: an address, such as https://spdx.org/licenses/CC-BY-4.0"
        )
    if out.exists() and any(out.iterdir()):
        raise InputError(f"{out} is not an empty folder")
    crate = ROCrate(version="1.1")  # which the profile is of
    add_study_to_crate(crate, results, license_, author)
    if zipped:
        path = out.with_name(f"{out.name}.zip")
        write_atomically(path, b"".join(crate.stream_zip()))
        return path
    try:
        crate.write(out)
    except OSError:
        rmtree(out, ignore_errors=True)  # which was empty: a half of one would be in the way
        raise
    return out


def add_study_to_crate(crate: "ROCrate", results: Results, license_: str, author: str) -> None:
    """Add to a crate the files of a study, the program that produced them, and the record of its run."""
    from rocrate.model.contextentity import ContextEntity
    from rocrate.model.person import Person
    from rocrate.model.softwareapplication import SoftwareApplication

    folder, stored, exp = results.folder, results.stored, results.exp
    profile = {"@type": "CreativeWork", "name": "Process Run Crate", "version": "0.5"}
    crate.add(ContextEntity(crate, CRATE_PROFILE, properties=profile))
    crate.add(ContextEntity(crate, license_, properties={"@type": "CreativeWork", "name": license_.rpartition("/")[2]}))
    root: Any = crate.root_dataset
    root["conformsTo"] = {"@id": CRATE_PROFILE}
    root["name"] = f"{results.name}: {exp.scenario}"
    root["description"] = (
        f"{results.finished_count} rollouts of {exp.scenario} on {exp.settings.name}, by sweep {VERSION}"
    )
    root["license"] = {"@id": license_}
    crate.datePublished = datetime.now(UTC).replace(microsecond=0)
    given = [
        crate.add_file(path_inside_folder(folder, name), f"{STUDY_FOLDER}/{name}", properties=describe_file(name))
        for name in (store.STUDY_FILE, store.POINTS_FILE)
    ]
    if read := exp.system.source_files():
        sources = {**read, project.PROJECT_FILE: io.StringIO("modules: []\n")}
        given += [crate.add_file(file, f"{PROJECT_FOLDER}/{name}", properties=describe_file(name, "what is simulated"))
                  for name, file in sources.items()]  # fmt: skip
    made = [
        crate.add_file(path_inside_folder(folder, name), f"{STUDY_FOLDER}/{name}", properties=describe_file(name))
        for name in list_stored_files(folder)
    ]
    made += [
        crate.add_file(path_inside_folder(folder, name), name, properties=describe_file(name))
        for name in PICTURE_FILES
        if path_inside_folder(folder, name).exists()
    ]
    programs: list[Any] = [
        crate.add(SoftwareApplication(crate, f"{PYPI}/{name}/{number}/#{version}",
                                      properties={"name": name, "softwareVersion": version, "url": f"{PYPI}/{name}"}))
        for name, number, version in (("insect-sweep", VERSION, stored["commit"] or stored["code"]),
                                      *((name, number, number) for name, number in stored["versions"].items()))
    ]  # fmt: skip
    program = programs[0]
    program["softwareRequirements"] = programs[1:]
    began, ended = run_dates(folder)
    run = {
        "name": f"simulation of {results.name}",
        "description": f"on {'; '.join(stored['devices'])}; `sweep reproduce` simulates its rows again",
    }
    for key, day in (("startTime", began), ("endTime", ended)):
        if day:
            run[key] = datetime.fromisoformat(day).isoformat()
    action: Any = crate.add_action(program, "#run", object=given, result=made, properties=run)
    root["mentions"] = action
    if author:
        root["author"] = action["agent"] = crate.add(Person(crate, "#author", properties={"name": author}))


def list_stored_files(folder: Path) -> Iterator[str]:
    """List the files of a study's folder that belong to the study, except its plan and configuration."""
    yield manifest.MANIFEST_FILE
    if path_inside_folder(folder, store.LOG_FILE).exists():
        yield store.LOG_FILE
    yield from (entry.file for entry in manifest.read_manifest(folder) if entry.file != store.POINTS_FILE)


def describe_file(name: str, meaning: str = "") -> dict[str, Any]:
    """Return name, meaning and media type of a file, as a crate records them."""
    kind = {".parquet": "application/vnd.apache.parquet", ".yaml": "application/yaml"}.get(Path(name).suffix)
    other = "finished rows" if name.endswith(".parquet") else f"picture of the study, {name}"
    form = kind or mimetypes.guess_type(name)[0] or "text/plain"
    return {"name": name, "description": meaning or FILE_MEANINGS.get(name, other), "encodingFormat": form}


@contextlib.contextmanager
def unpack_crate(path: Path) -> Iterator[Path]:
    """Context that yields the folder of a crate, temporarily unpacked if it is an archive; imports nothing in it.

    Args:
        path: A crate, a folder or a ZIP archive, which may come from a stranger.

    Yields:
        The folder of the crate, until the context ends.

    Raises:
        InputError: It is no crate of a study, or an archive that cannot or should not be unpacked.
    """
    with tempfile.TemporaryDirectory() as room:
        folder = path
        if path.is_file():
            unpack_archive(path, folder := Path(room))
        if not all(
            path_inside_folder(folder, name).exists()
            for name in (project.CRATE_FILE, f"{STUDY_FOLDER}/{store.STUDY_FILE}")
        ):
            raise InputError(f"{path} is not a crate of a study: `sweep export DIR --crate FOLDER` writes one")
        yield folder.resolve()


def unpack_archive(path: Path, to: Path) -> None:
    """Unpack a ZIP archive that may be untrusted.

    Args:
        path: The archive.
        to: An empty folder.

    Raises:
        InputError: It is damaged, encrypted, compressed by a method other than deflate, or unpacks to too much. The
            sizes that it declares are checked before anything is unpacked, and no file is read beyond them.
    """
    import zipfile

    try:
        with zipfile.ZipFile(path) as packed:
            files, size = packed.infolist(), path.stat().st_size
            total = sum(one.file_size for one in files)
            if any(one.flag_bits & ENCRYPTED_FLAG for one in files):
                raise InputError(f"{path} is encrypted: unpack it, and give the folder")
            if others := [one for one in files if one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)]:
                raise InputError(
                    f"{path}: {others[0].filename} is not compressed by deflate: unpack it, and give the folder"
                )
            if len(files) > MAX_FILES or total > max(
                ALWAYS_ALLOWED_BYTES, min(MAX_UNPACKED_BYTES, MAX_COMPRESSION_RATIO * size)
            ):
                raise InputError(
                    f"{path} is not allowed: its {size:,} bytes unpack to {total:,} in {len(files):,} files, more than "
                    f"{MAX_COMPRESSION_RATIO} times its size, {MAX_UNPACKED_BYTES:,} bytes or {MAX_FILES:,} files"
                )
            packed.extractall(to)
    except InputError:
        raise
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, RuntimeError, OSError) as error:
        raise InputError(f"{path} cannot be unpacked: {(str(error) or type(error).__name__).splitlines()[0]}") from None


def list_code_files(crate: Path) -> list[str]:
    """List files of a crate that Python would import or a runtime would execute, without importing anything.

    Args:
        crate: Folder of the crate.

    Returns:
        A line for each module and controller that is named, and for each file of code, with its SHA-256. Empty for a
        study of the built-in robots, which is simulated by this package alone.

    Raises:
        InputError: `study.yaml` or the project's `sweep.yaml` cannot be read.
    """
    place, config = (
        path_inside_folder(crate, PROJECT_FOLDER),
        store.read_study(path_inside_folder(crate, STUDY_FOLDER))["config"],
    )
    lines = [f"controller {printable_name(name)}" for name in list_controllers(config)]
    if place.is_dir():
        if path_inside_folder(place, project.PROJECT_FILE).is_file():
            settings = project.read_settings(place)
            lines += [f"module {name}, by {project.PROJECT_FILE}" for name in settings["modules"]]
        for file in sorted(place.rglob("*")):
            path = path_inside_folder(crate, file.relative_to(crate))  # which refuses links to code elsewhere
            if file.name.endswith(CODE_SUFFIXES) and path.is_file():
                sha256 = digest_file(path)
                lines.append(f"{printable_name(file.relative_to(crate))}, SHA-256 {sha256}")
    return lines


def list_controllers(config: Mapping[str, Any]) -> list[str]:
    """List the controllers that a stored configuration names, in its scenario and in values of its axes."""
    model, study = config.get("model"), config.get("study")
    axes = study.get("axes") if isinstance(study, Mapping) else None
    named = [model.get("controller")] if isinstance(model, Mapping) else []
    for axis in axes.values() if isinstance(axes, Mapping) else ():
        if isinstance(axis, Mapping) and axis.get("path") == "model.controller":
            values = axis.get("values")
            named += values if isinstance(values, list) else []
    return list(dict.fromkeys(str(name) for name in named if name))


def use_crate_project(crate: Path) -> contextlib.AbstractContextManager[None]:
    """Make the project in a crate the current one, so that its modules can be imported; keep the present project if it
    has none."""
    place = path_inside_folder(crate, PROJECT_FOLDER)
    return project.trust_project(place) if place.is_dir() else contextlib.nullcontext()
