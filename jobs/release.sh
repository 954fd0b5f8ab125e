#!/usr/bin/env bash
# A release up to the last step before its upload: changelog from fragments, wheel and sdist, the wheel checked in an empty
# environment, the site, and digests of all files. In a copy: the checkout stays as it is. Everything is left in build/release.
#   jobs/release.sh VERSION [PYTHON ...], such as jobs/release.sh 0.3.0 python3.12 python3.13; without Pythons no wheel is run
# DOI=10.5281/zenodo.1234567 puts the DOI that an archive has reserved into the citation (jobs/zenodo.py reserves one).
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
version=$1
shift
out=$root/build/release
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
bin=$root/.venv/bin

[ -z "$(git -C "$root" status --porcelain --untracked-files=no)" ] || { echo "jobs/release.sh: commit first" >&2; exit 1; }
git clone -q --local --no-hardlinks "$root" "$work/copy"
cd "$work/copy"
ln -s "$root/.venv" .venv
"$bin/python" jobs/set_version.py "$version" ${DOI:+"$DOI"}
PYTHONPATH=$work/copy "$bin/python" docs/reference_pages.py >/dev/null  # a page states the version
if ! grep -q "^## $version " CHANGELOG.md; then  # a tagged commit has it
  "$bin/towncrier" build --yes --version "$version" >/dev/null
fi
git -c user.name=release -c user.email=release@localhost commit -qam "ci: release $version" || true  # of a tag nothing differs

jobs/wheel.sh "$@"
"$bin/python" - "$version" dist/* <<'PYTHON'
import sys
for name in sys.argv[2:]:
    assert f"insect_sweep-{sys.argv[1]}" in name, f"{name} is not of {sys.argv[1]}"
PYTHON
NO_MKDOCS_2_WARNING=1 "$bin/mkdocs" build -q

rm -rf "$out"
mkdir -p "$out"
cp dist/* CITATION.cff .zenodo.json requirements.lock "$out/"
sdist=insect_sweep-$version.tar.gz
page=${GITHUB_REPOSITORY:+$GITHUB_SERVER_URL/$GITHUB_REPOSITORY/releases/download/v$version}
digest=$(sha256sum "dist/$sdist" | cut -d' ' -f1)
sed "s|^  path: .*|  url: ${page:-file://$out}/$sdist\n  sha256: $digest|" packaging/conda/recipe.yaml >"$out/conda_recipe.yaml"
tar -C build -czf "$out/site.tar.gz" site
sed -n "/^## $version /,/^## /p" CHANGELOG.md | sed '1d;/^## /d' >"$out/notes.md"
cd "$out"
sha256sum -- * >SHA256SUMS
cat SHA256SUMS
echo "jobs/release.sh: nothing was uploaded or tagged; see .github/workflows/release.yaml for what follows"
