"""The certificate of a study's region of few failures, as `sweep certify` stores it in the folder for the page."""

import json
import sys
from pathlib import Path
from typing import Any

from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder, read_bytes_limited, write_atomically
from sweep.core.json_values import to_json_value

CERTIFICATE_FILE = "certificate.json"
MAX_BYTES = 1_000_000


def save_certificate(folder: Path, values: dict[str, Any], exp: Experiment) -> None:
    """Store the latest certificate in a study's folder; where that cannot be written, say so on the standard error.

    Args:
        folder: Folder of the study.
        values: Plain values of the certificate.
        exp: Experiment of the study, whose thresholds the certificate holds for.
    """
    content = json.dumps(to_json_value({**values, "thresholds": str(exp.thresholds)}), indent=1)
    try:
        write_atomically(path_inside_folder(folder, CERTIFICATE_FILE), f"{content}\n".encode())
    except InputError as error:
        print(f"sweep: {error}: its page will not show the region", file=sys.stderr)


def read_certificate(folder: Path, exp: Experiment) -> dict[str, Any] | None:
    """Read the certificate in a study's folder.

    Args:
        folder: Folder of the study.
        exp: Experiment of the study.

    Returns:
        The stored values; None if there is no certificate, no region was certified, the file is damaged, or the
        certificate is for other thresholds than those of the study now.
    """
    try:
        values = json.loads(read_bytes_limited(path_inside_folder(folder, CERTIFICATE_FILE), MAX_BYTES))
    except (OSError, InputError, ValueError, RecursionError):
        return None
    holds = isinstance(values, dict) and values.get("thresholds") == str(exp.thresholds)
    return values if holds and values.get("certified") is True else None
