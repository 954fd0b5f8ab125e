"""Check the subjects of commits: `python jobs/check_subjects.py BASE..HEAD`, as CI does for a pull request.

A subject is `area: imperative` of at most 72 characters, see CONTRIBUTING.md.
"""

import argparse
import re
import subprocess
from collections.abc import Iterator

LONGEST = 72
SUBJECT = re.compile(r"[a-z][\w/.,-]*: \S.*[^.\s]")
# git makes them; a pull request is merged or squashed under its title
MADE_BY_GIT = re.compile(r"(Merge|Revert|fixup!|squash!) ")


def faults(subjects: list[str]) -> Iterator[str]:
    """Yield one line for each subject that breaks the rule."""
    for subject in subjects:
        if MADE_BY_GIT.match(subject):
            continue
        if not SUBJECT.fullmatch(subject):
            yield f"{subject!r} is not allowed: `area: imperative`, such as `report: describe SVG output`"
        elif len(subject) > LONGEST:
            yield f"{subject!r} is not allowed: {len(subject)} characters, at most {LONGEST}"


def main() -> int:
    """Print the faults of a range of commits; the exit code is 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commits", help="a range of commits, such as origin/main..HEAD")
    log = ["git", "log", "--no-merges", "--format=%s", parser.parse_args().commits]
    lines = [*faults(subprocess.run(log, capture_output=True, text=True, check=True).stdout.splitlines())]
    print("\n".join(lines), end="\n" if lines else "")
    return int(bool(lines))


if __name__ == "__main__":
    raise SystemExit(main())
