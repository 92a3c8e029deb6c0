# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the file of weights that ``--lpips-weights`` takes, from the two public ones that LPIPS is made of.

    .venvs/backend/bin/python lab/tools/lpips_weights.py --out lpips.npz --download
    .venvs/backend/bin/python lab/tools/lpips_weights.py --out lpips.npz --alexnet A.pth --heads H.pth

AlexNet's convolutions are torchvision's (BSD-3-Clause), the linear heads LPIPS's v0.1 (BSD-2-Clause). Each is
taken from its option; else AlexNet from torch.hub's cache, the heads from an installed package ``lpips``;
else, with --download, from their authors, into that cache. Files are read as weights alone: no code in them
is run.
"""

import argparse
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from physhdr.backend.evaluate.lpips import SHAPES, Lpips
from physhdr.bridge.atomic import atomic_path
from physhdr.bridge.errors import FileDamagedError, FileMissingError, OutputError, PhysHDRError
from physhdr.bridge.regular import damaged_where_it_fails, regular_file

#: Where the authors offer the files, and how the SHA-256 of each begins.
ALEXNET = "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth", "7be5be79"
HEADS = (
    "https://raw.githubusercontent.com/richzhang/PerceptualSimilarity/master/lpips/weights/v0.1/alex.pth",
    "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
)
#: How they are called in torch.hub's cache: the heads by us, as "alex.pth" says too little there.
ALEXNET_CACHED, HEADS_CACHED = "alexnet-owt-*.pth", "lpips-v0.1-alex.pth"
REMEDY = f"Call with --download, or fetch {ALEXNET[0]} and {HEADS[0]} and give them as --alexnet and --heads."


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="the .npz to write")
    parser.add_argument("--alexnet", type=Path, help="torchvision's state dict of AlexNet (.pth)")
    parser.add_argument("--heads", type=Path, help="LPIPS's v0.1 linear heads for AlexNet (alex.pth)")
    parser.add_argument("--download", action="store_true", help="fetch what is not here (244 MB and 6 kB)")
    given = parser.parse_args()
    try:
        alexnet = given.alexnet or _found(_cached(ALEXNET_CACHED), ALEXNET, given.download)
        heads = given.heads or _found(_of_the_package() or _cached(HEADS_CACHED), HEADS, given.download)
        arrays = converted(_state_dict(alexnet), _state_dict(heads), f"{alexnet} and {heads}")
        with atomic_path(given.out) as temporary, open(temporary, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        Lpips.from_file(given.out)  # what evaluation will do with it
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    print(f"wrote {given.out} from {alexnet} and {heads}")
    return 0


def converted(
    alexnet: Mapping[str, torch.Tensor], heads: Mapping[str, torch.Tensor], whose: str
) -> dict[str, np.ndarray]:
    """The arrays of our file, float32, of two state dicts; raises ``FileDamagedError`` naming ``whose``."""
    wanted: dict[str, tuple[Mapping[str, torch.Tensor], str, tuple[int, ...]]] = {}
    for i, (name, (wide, deep, side)) in enumerate(SHAPES.items()):
        layer = f"features.{name.removeprefix('conv')}"
        wanted[f"{name}.weight"] = alexnet, f"{layer}.weight", (wide, deep, side, side)
        wanted[f"{name}.bias"] = alexnet, f"{layer}.bias", (wide,)
        wanted[f"lin{i}"] = heads, f"lin{i}.model.1.weight", (1, wide, 1, 1)
    arrays = {}
    for name, (source, key, shape) in wanted.items():
        found = source.get(key)
        if not isinstance(found, torch.Tensor) or tuple(found.shape) != shape:
            there = "nothing" if found is None else tuple(getattr(found, "shape", ()))
            raise FileDamagedError(
                f"{whose} are not AlexNet and its heads: {key} is {there}, not {shape}", REMEDY
            )
        array = found.detach().to(torch.float32).numpy()
        arrays[name] = array.reshape(-1) if name.startswith("lin") else array
    return arrays


def _state_dict(path: Path) -> Mapping[str, torch.Tensor]:
    regular_file(path, REMEDY)
    with damaged_where_it_fails(f"{path} is not a file of weights", REMEDY):
        content = torch.load(path, map_location="cpu", weights_only=True)
        if not isinstance(content, dict):
            raise ValueError(f"it holds a {type(content).__name__}")
    return content


def _found(path: Path | None, public: tuple[str, str], download: bool) -> Path:
    """``path`` where there is one, else what is offered as ``public`` (address, SHA-256), if it may be."""
    if path is not None:
        return path
    address, digest = public
    if not download:
        raise FileMissingError(f"{address.rpartition('/')[2]} is not here", REMEDY)
    name = HEADS_CACHED if public is HEADS else address.rpartition("/")[2]
    to = _cache() / name
    try:
        to.parent.mkdir(parents=True, exist_ok=True)
        torch.hub.download_url_to_file(address, str(to), hash_prefix=digest, progress=sys.stderr.isatty())
    except (OSError, RuntimeError) as error:  # no network, no space, another file than it was
        raise OutputError(f"cannot fetch {address}: {error}", REMEDY) from error
    return to


def _cache() -> Path:
    return Path(torch.hub.get_dir()) / "checkpoints"


def _cached(pattern: str) -> Path | None:
    return next(iter(sorted(_cache().glob(pattern))), None)


def _of_the_package() -> Path | None:
    """The heads in an installed package ``lpips``, which is not imported: it would want torchvision."""
    found = importlib.util.find_spec("lpips")
    for folder in (found.submodule_search_locations or ()) if found else ():
        path = Path(folder) / "weights" / "v0.1" / "alex.pth"
        if path.is_file():
            return path
    return None


if __name__ == "__main__":
    sys.exit(main())
