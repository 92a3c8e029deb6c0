# SPDX-License-Identifier: GPL-3.0-or-later
"""lab/tools/lpips_weights.py on stand-ins of the two public files: the distances are those of plain torch."""

import hashlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from physhdr.backend.evaluate.lpips import Lpips

TOOL = Path(__file__).resolve().parents[3] / "lab" / "tools" / "lpips_weights.py"
#: Ends of the slices of AlexNet that LPIPS compares, and how wide each is.
ENDS, WIDTHS = (2, 5, 8, 10, 12), (64, 192, 384, 256, 256)


@pytest.fixture
def tool(tmp_path, monkeypatch):
    """The tool, with an empty cache of torch.hub."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    spec = importlib.util.spec_from_file_location("lpips_weights", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def features() -> nn.Sequential:
    """torchvision's ``alexnet().features``, as Krizhevsky (2014) has it."""
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, padding=2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
    )


@pytest.fixture(scope="module")
def public(tmp_path_factory):
    """``alexnet.pth`` and ``alex.pth`` with the keys of the public files and numbers of our own."""
    torch.manual_seed(0)
    folder, network = tmp_path_factory.mktemp("public"), features()
    content = {f"features.{key}": value for key, value in network.state_dict().items()}
    torch.save(content | {"classifier.1.weight": torch.zeros(4, 4)}, folder / "alexnet.pth")
    heads = {f"lin{i}.model.1.weight": torch.rand(1, wide, 1, 1) for i, wide in enumerate(WIDTHS)}
    torch.save(heads, folder / "alex.pth")
    return folder


@torch.no_grad()
def distance(public: Path, picture: torch.Tensor, other: torch.Tensor) -> float:
    """LPIPS by its definition (Zhang et al. 2018, eq. 1) in float64, with torch's own modules."""
    network, heads = features().double(), torch.load(public / "alex.pth")
    loaded = torch.load(public / "alexnet.pth")
    network.load_state_dict(
        {k.removeprefix("features."): v for k, v in loaded.items() if k.startswith("features")}
    )
    shift = torch.tensor([-0.030, -0.088, -0.188], dtype=torch.float64).view(3, 1, 1)
    scale = torch.tensor([0.458, 0.448, 0.450], dtype=torch.float64).view(3, 1, 1)
    planes = [((2.0 * each.double() - 1.0 - shift) / scale)[None] for each in (picture, other)]
    total, begin = 0.0, 0
    for i, end in enumerate(ENDS):
        planes = [network[begin:end](each) for each in planes]
        units = [nn.functional.normalize(each, dim=1) for each in planes]
        total += nn.functional.conv2d(
            (units[0] - units[1]) ** 2, heads[f"lin{i}.model.1.weight"].double()
        ).mean()
        begin = end
    return float(total)


def run(tool, monkeypatch, *words) -> int:
    monkeypatch.setattr(sys, "argv", ["lpips_weights.py", *map(str, words)])
    return tool.main()


def test_the_distances_are_those_of_the_public_networks(tool, public, tmp_path, monkeypatch, capsys):
    out = tmp_path / "a" / "lpips.npz"
    words = ["--alexnet", public / "alexnet.pth", "--heads", public / "alex.pth", "--out", out]
    assert run(tool, monkeypatch, *words) == 0
    assert f"wrote {out} from" in capsys.readouterr().out
    rng = torch.Generator().manual_seed(1)
    picture, other = torch.rand(2, 3, 70, 90, generator=rng)
    ours, unscaled = Lpips.from_file(out).both(picture, other)
    assert ours == pytest.approx(distance(public, picture, other), rel=1e-4)
    # Inputs that LPIPS scales to 0…1 are those that the other number is of.
    assert unscaled == pytest.approx(distance(public, 0.5 * picture + 0.5, 0.5 * other + 0.5), rel=1e-4)
    assert ours > 1.1 * unscaled > 0


def test_it_takes_what_is_installed_or_in_torchs_cache(tool, public, tmp_path, monkeypatch):
    cache = tmp_path / "torch" / "hub" / "checkpoints"
    cache.mkdir(parents=True)
    (cache / "alexnet-owt-7be5be79.pth").write_bytes((public / "alexnet.pth").read_bytes())
    package = tmp_path / "site" / "lpips"
    (package / "weights" / "v0.1").mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('it wants torchvision')")
    (package / "weights" / "v0.1" / "alex.pth").write_bytes((public / "alex.pth").read_bytes())
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert run(tool, monkeypatch, "--out", tmp_path / "lpips.npz") == 0
    with np.load(tmp_path / "lpips.npz") as file:
        heads = torch.load(public / "alex.pth")
        np.testing.assert_array_equal(file["lin3"], heads["lin3.model.1.weight"].flatten())


def test_it_fetches_what_is_not_here(tool, public, tmp_path, monkeypatch, capsys):
    for name, file in (("ALEXNET", "alexnet.pth"), ("HEADS", "alex.pth")):
        digest = hashlib.sha256((public / file).read_bytes()).hexdigest()
        monkeypatch.setattr(tool, name, ((public / file).as_uri(), digest[:8]))
    assert run(tool, monkeypatch, "--out", tmp_path / "lpips.npz", "--download") == 0
    assert Lpips.from_file(tmp_path / "lpips.npz")
    monkeypatch.setattr(tool, "HEADS", ((public / "alex.pth").as_uri(), "00000000"))
    for path in (tmp_path / "torch" / "hub" / "checkpoints").glob("lpips-*"):
        path.unlink()
    assert run(tool, monkeypatch, "--out", tmp_path / "other.npz", "--download") == 1
    assert "invalid hash value" in capsys.readouterr().err and not (tmp_path / "other.npz").exists()


def test_what_is_missing_or_no_such_file_is_told(tool, public, tmp_path, monkeypatch, capsys):
    def said(*words) -> str:
        assert run(tool, monkeypatch, "--out", tmp_path / "lpips.npz", *words) == 1
        message = capsys.readouterr().err
        assert message.startswith("error: ") and "--download" in message
        return message

    assert "alexnet-owt-7be5be79.pth is not here" in said()
    alexnet, heads = public / "alexnet.pth", public / "alex.pth"
    monkeypatch.setattr(tool, "_of_the_package", lambda: None)
    assert "alex.pth is not here" in said("--alexnet", alexnet)
    assert "is missing" in said("--alexnet", tmp_path / "none", "--heads", heads)
    (tmp_path / "text.pth").write_text("weights")
    assert "is not a file of weights" in said("--alexnet", tmp_path / "text.pth", "--heads", heads)
    assert "features.0.weight is nothing" in said("--alexnet", heads, "--heads", alexnet)
    wide = torch.load(heads) | {"lin2.model.1.weight": torch.zeros(1, 3, 1, 1)}
    torch.save(wide, tmp_path / "wide.pth")
    message = said("--alexnet", alexnet, "--heads", tmp_path / "wide.pth")
    assert "lin2.model.1.weight is (1, 3, 1, 1), not (1, 384, 1, 1)" in message
    assert not (tmp_path / "lpips.npz").exists()


@pytest.mark.long
def test_it_can_be_called_by_its_path():
    done = subprocess.run([sys.executable, TOOL, "--help"], capture_output=True, text=True)
    assert done.returncode == 0 and "--download" in done.stdout
