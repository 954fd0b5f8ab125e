"""What a release consists of beside its wheel: citation, archive, recipes of conda and of containers."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
import tomllib
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version
from pandas.compat._optional import VERSIONS
from rattler_build import Stage0Recipe

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
STATED = ("pyproject.toml", "sweep/core/version.py", "CITATION.cff", ".zenodo.json", "packaging/conda/recipe.yaml")
DOI = "10.5281/zenodo.1234567"
# packages whose names conda-forge spells otherwise
CONDA = {"matplotlib": "matplotlib-base", "mujoco": "mujoco-python"}


@pytest.fixture
def checkout(tmp_path):
    for name in (*STATED, "jobs/set_version.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def set_version(checkout: Path, *words: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(checkout / "jobs/set_version.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def cited_and_archived(checkout: Path) -> tuple[dict, dict]:
    return yaml.safe_load((checkout / "CITATION.cff").read_text()), json.loads((checkout / ".zenodo.json").read_text())


def test_version_and_doi_are_in_every_file_that_states_them(checkout):
    assert "doi" not in cited_and_archived(checkout)[0]  # a placeholder would be cited
    assert set_version(checkout, "9.8.7", DOI).returncode == 0
    cited, archived = cited_and_archived(checkout)
    assert cited["doi"] == archived["doi"] == DOI
    for name in STATED:
        assert "9.8.7" in (checkout / name).read_text()
    assert set_version(checkout, "9.9.0").returncode == 0  # which has none yet
    cited, archived = cited_and_archived(checkout)
    assert "doi" not in cited
    assert "doi" not in archived
    assert archived["version"] == "9.9.0"


def test_what_is_no_doi_is_refused(checkout):
    found = set_version(checkout, "9.8.7", "zenodo.1234567")
    assert found.returncode == 2
    assert found.stderr.count("\n") == 1
    assert "9.8.7" not in (checkout / "CITATION.cff").read_text()


class Archive(BaseHTTPRequestHandler):
    """A server that answers as Zenodo's documentation says, and keeps what it was asked."""

    def answer(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        here = f"http://localhost:{self.server.server_port}"
        path = self.path.removeprefix("/api/deposit/depositions")
        self.server.asked.append((self.command, path, body, self.headers["Authorization"]))
        deposit = {"id": 8, "doi": DOI, "metadata": {"prereserve_doi": {"doi": DOI}}, "files": [{"id": "old"}]}
        deposit["links"] = {"bucket": f"{here}/bucket", "latest_draft": f"{here}/api/deposit/depositions/8"}
        text = b"" if self.command == "DELETE" else json.dumps(deposit).encode()
        self.send_response(204 if self.command == "DELETE" else 200)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    do_GET = do_POST = do_PUT = do_DELETE = answer

    def log_message(self, *_):
        pass


@pytest.fixture
def archive():
    with HTTPServer(("localhost", 0), Archive) as server:
        server.asked = []
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def zenodo(archive: HTTPServer, *words: str, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(ROOT / "jobs/zenodo.py"), *words]
    known = {"ZENODO_API": f"http://localhost:{archive.server_port}/api", **environment}
    inherited = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    return subprocess.run(command, capture_output=True, text=True, check=True, env={**inherited, **known})


def test_a_doi_is_reserved_before_the_files_are_built(archive):
    found = zenodo(archive, "reserve", ZENODO_TOKEN="secret")
    assert found.stdout == f"DOI={DOI}\nDEPOSIT=8\n"
    assert archive.asked == [("POST", "", b"{}", "Bearer secret")]
    archive.asked.clear()
    assert zenodo(archive, "reserve", ZENODO_TOKEN="secret", ZENODO_RECORD="7").stdout == found.stdout
    assert [asked[:2] for asked in archive.asked] == [
        ("POST", "/7/actions/newversion"),
        ("GET", "/8"),
        ("DELETE", "/8/files/old"),
    ]


def test_without_a_token_nothing_is_asked(archive):
    found = zenodo(archive, "reserve", ZENODO_TOKEN="")
    assert found.stdout == ""
    assert found.stderr.count("\n") == 1
    assert archive.asked == []


def test_a_release_is_archived_with_its_metadata(archive, tmp_path):
    (tmp_path / "wheel.whl").write_bytes(b"wheel")
    (tmp_path / ".zenodo.json").write_text(f'{{"title": "insect-sweep", "doi": "{DOI}"}}')
    assert DOI in zenodo(archive, "upload", "8", str(tmp_path), ZENODO_TOKEN="secret").stdout
    puts = {path: body for method, path, body, _ in archive.asked if method == "PUT"}
    assert puts.pop("/bucket/wheel.whl") == b"wheel"
    metadata = json.loads(puts.pop("/8"))["metadata"]
    assert metadata["title"] == "insect-sweep"
    assert "doi" not in metadata  # one that is given counts as another archive's
    assert not puts
    assert archive.asked[-1][:2] == ("POST", "/8/actions/publish")


def test_the_conda_recipe_asks_for_what_the_wheel_asks_for():
    """As rattler-build renders it."""
    (rendered,) = Stage0Recipe.from_file(str(ROOT / "packaging/conda/recipe.yaml")).render()
    recipe = rendered.recipe.to_dict()
    python, *run = recipe["requirements"]["run"]
    assert python == f"python {PROJECT['requires-python']}"
    wanted = []
    for requirement in PROJECT["dependencies"]:
        name, versions = re.fullmatch(r"([\w-]+)(.*)", requirement).groups()
        wanted.append(f"{CONDA.get(name, name.lower())} {versions.removeprefix('==')}")
    assert sorted(run) == sorted(wanted)
    assert recipe["build"]["python"]["entry_points"] == [f"{k} = {v}" for k, v in PROJECT["scripts"].items()]
    assert all((ROOT / name).exists() for name in recipe["about"]["license_file"])


def test_lower_bounds_are_those_of_pandas_too():
    """Pandas refuses an older Jinja2 and the like where it is used, whatever installed it."""
    extras = [requirement for extra in PROJECT["optional-dependencies"].values() for requirement in extra]
    allowed = [Requirement(text) for text in (*PROJECT["dependencies"], *extras)]
    shared = [one for one in allowed if one.name in VERSIONS]
    assert len(shared) > 4
    for one in shared:
        lowest = max(Version(part.version) for part in one.specifier if part.operator == ">=")
        assert lowest >= Version(VERSIONS[one.name]), one.name


def test_images_hold_what_their_script_reads():
    """Both recipes copy into /source what packaging/install.sh looks for there."""
    script = (ROOT / "packaging/install.sh").read_text()
    read = set(re.findall(r'"\$source"?/([\w./*-]+)', script))
    assert read == {"dist/insect_sweep-*.whl", "requirements.lock", "constraints.txt"}
    docker = " ".join(re.findall(r"^COPY (.*) /source/", (ROOT / "Dockerfile").read_text(), re.MULTILINE)).split()
    definition = (ROOT / "packaging/sweep.def").read_text().partition("%files")[2].partition("%post")[0]
    apptainer = re.findall(r"^    (\S+) /source/", definition, re.MULTILINE)
    ignored = [line[1:] for line in (ROOT / ".dockerignore").read_text().split() if line.startswith("!")]
    copied = {"constraints.txt", "dist/*.whl", "packaging/install.sh", "requirements.lock"}
    assert set(docker) == set(apptainer) == set(ignored) == copied


@pytest.mark.parametrize("image", [None, "sweep.sif"])
def test_the_slurm_job_runs_an_image_where_one_is_named(tmp_path, image):
    """Stand-ins note how they are called: an image's command runs in one job, without workers of its own."""
    for name in ("sweep", "apptainer"):
        (tmp_path / name).write_text(f'#!/bin/sh\necho {name} "$@" >>{tmp_path}/called\n')
        (tmp_path / name).chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", **({"SWEEP_IMAGE": image} if image else {})}
    subprocess.run(["bash", str(ROOT / "jobs/slurm.sh"), "out"], env=environment, cwd=tmp_path, check=True)
    run, report = (tmp_path / "called").read_text().splitlines()
    before = "apptainer exec --nv sweep.sif sweep" if image else "sweep"
    assert run.startswith(f"{before} run study=walk_map out=out ")
    assert ("cluster=local" in run.split()) == bool(image)
    assert ("cluster=slurm" in run.split()) != bool(image)
    assert report == f"{before} report out"
