"""Archive a release at Zenodo: reserve a DOI before its files are built, and upload them afterwards.

    python3 jobs/zenodo.py reserve             # prints DOI=... and DEPOSIT=..., lines for GITHUB_OUTPUT
    python3 jobs/zenodo.py upload 123 FOLDER   # files of FOLDER, metadata of its .zenodo.json; publishes deposit 123

ZENODO_TOKEN allows both. ZENODO_RECORD is the number of an earlier version, of which this becomes a new version;
without it the deposit is a new one. ZENODO_API names another server, such as Zenodo's sandbox. Without a token,
`reserve` only says so.
"""

import json
import os
import sys
import urllib.request
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

API = os.environ.get("ZENODO_API", "https://zenodo.org/api") + "/deposit/depositions"


def main() -> int:
    """Carry out the step that the arguments name."""
    match sys.argv[1:]:
        case ["reserve"]:
            return reserve()
        case ["upload", deposit, folder]:
            return upload(deposit, Path(folder))
    print(__doc__, file=sys.stderr)
    return 2


def reserve() -> int:
    """Make an empty deposit and print its DOI."""
    if not os.environ.get("ZENODO_TOKEN"):
        print("zenodo: no ZENODO_TOKEN: the release has no DOI", file=sys.stderr)
        return 0
    if earlier := os.environ.get("ZENODO_RECORD"):
        draft = request("POST", f"{API}/{earlier}/actions/newversion")["links"]["latest_draft"]
        deposit = request("GET", draft)
        for file in deposit["files"]:  # of the earlier version
            request("DELETE", f"{draft}/files/{file['id']}")
    else:
        deposit = request("POST", API, {})
    print(f"DOI={deposit['metadata']['prereserve_doi']['doi']}\nDEPOSIT={deposit['id']}")
    return 0


def upload(deposit: str, folder: Path) -> int:
    """Upload the files of a release and publish its deposit."""
    metadata = json.loads((folder / ".zenodo.json").read_text(encoding="utf-8"))
    metadata.pop("doi", None)  # which the deposit has
    metadata["prereserve_doi"] = True
    metadata["publication_date"] = f"{datetime.now(UTC):%Y-%m-%d}"
    url = f"{API}/{deposit}"
    bucket = request("GET", url)["links"]["bucket"]
    for file in sorted(folder.iterdir()):
        if not file.name.startswith("."):
            request("PUT", f"{bucket}/{file.name}", file.read_bytes())
    request("PUT", url, {"metadata": metadata})
    print(f"published {request('POST', f'{url}/actions/publish')['doi']}")
    return 0


def request(method: str, url: str, content: dict | bytes | None = None) -> Any:
    """Return Zenodo's answer to one request; None if it is empty."""
    kind = "application/octet-stream" if isinstance(content, bytes) else "application/json"
    data = json.dumps(content).encode() if isinstance(content, dict) else content
    headers = {"Authorization": f"Bearer {os.environ['ZENODO_TOKEN']}", "Content-Type": kind}
    with urllib.request.urlopen(urllib.request.Request(url, data, headers, method=method), timeout=300) as answer:
        text = answer.read()
    return json.loads(text) if text else None


if __name__ == "__main__":
    sys.exit(main())
