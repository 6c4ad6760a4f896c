#!/usr/bin/env bash
# Builds a release archive and the Python wheel for this machine's platform:
#
#   scripts/release.sh [OUT_DIR]        default: target/dist
#
# OUT_DIR/flyvine-VERSION-TARGET.tar.gz holds the binary, shell completions, manual pages, examples, data, the guide's
# sources, README, CHANGELOG and both licences; beside it its SHA-256. The same commit makes the same archive on the same
# toolchain. The wheel is scripts/wheel.sh's. Run it once on each platform that you release for.
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-target/dist}
version=$(sed -n '/^\[workspace.package\]/,/^\[/ s/^version = "\(.*\)"/\1/p' Cargo.toml)
target=$(rustc -vV | sed -n 's/^host: //p')
name=flyvine-$version-$target

if ! grep -q "^## \[$version\]" CHANGELOG.md; then
    echo "CHANGELOG.md has no section for $version" >&2
    exit 1
fi
cargo build --release --locked -p flyvine-cli
binary=target/release/flyvine
test "$("$binary" --version)" = "flyvine $version"

stage=$(mktemp -d)
trap 'rm -rf "$stage"' EXIT
root=$stage/$name
mkdir -p "$root/bin" "$root/share/man/man1" "$root/share/completions" "$root/docs"
install -m 755 "$binary" "$root/bin/flyvine"
"$binary" man --out "$root/share/man/man1"
for shell in bash zsh fish; do
    "$binary" completions "$shell" > "$root/share/completions/flyvine.$shell"
done
cp -r examples data "$root/"
cp -r docs/guide "$root/docs/guide"
cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$root/"

mkdir -p "$out"
# Names sorted, times and owners fixed: nothing of the machine gets in.
tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$(git log -1 --format=%ct)" \
    -C "$stage" -cf - "$name" | gzip -n > "$out/$name.tar.gz"
(cd "$out" && sha256sum "$name.tar.gz" > "$name.tar.gz.sha256")
echo "$out/$name.tar.gz"
scripts/wheel.sh "$out"
