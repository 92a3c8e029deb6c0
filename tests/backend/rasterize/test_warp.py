# SPDX-License-Identifier: GPL-3.0-or-later
"""What the rasteriser in Warp has of its own. That it keeps the contract is in test_contract.py and
test_adversarial.py, which run for it as well."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.errors import BadValueError

ROOT = Path(__file__).resolve().parents[3]
KERNELS = ROOT / "backend" / "rasterize" / "warp"
CAMERA = Camera(np.eye(4), 53, 38, 40.0, 44.0, 25.0, 20.0)


@pytest.fixture
def warp():
    return pytest.importorskip("warp", reason="warp-lang is not installed")


@pytest.fixture
def in_blocks(warp, monkeypatch):
    """A block's threads run as fibers, as a card's do."""
    if not hasattr(warp.config, "enable_cpu_blocks"):
        pytest.skip("before warp-lang 1.18 there are no blocks on the CPU")
    monkeypatch.setattr(warp.config, "enable_cpu_blocks", True)


@pytest.fixture
def deterministic():
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


def gaussians(count=200, channels=6, seed=0):
    """Means, quaternions, scales, opacities, colours in the view of ``CAMERA``, and zero screen offsets."""
    generator = torch.Generator().manual_seed(seed)
    depth = 1.0 + 2.0 * torch.rand(count, generator=generator)
    x, y = (torch.rand(2, count, generator=generator) - 0.5) * 1.5 * depth
    return [
        torch.stack([x, 0.7 * y, -depth], dim=1),
        torch.randn(count, 4, generator=generator),
        0.02 + 0.2 * torch.rand(count, 3, generator=generator) ** 3,
        0.05 + 0.9 * torch.rand(count, generator=generator),
        torch.rand(count, channels, generator=generator),
        torch.zeros(count, 2),
    ]


def gradients(implementation, tensors, dtype=torch.float32, camera=CAMERA):
    """A picture, and the gradients of random weights on it."""
    leaves = [t.to(dtype).clone().requires_grad_() for t in tensors]
    drawn = rasterize(*leaves[:5], camera, screen_offsets=leaves[5], implementation=implementation)
    generator = torch.Generator().manual_seed(1)
    weights = torch.randn(drawn.image.shape, generator=generator).to(dtype)
    (drawn.image * weights).sum().backward()
    return drawn, [leaf.grad for leaf in leaves]


def assert_close(ours, truth, tolerance=2e-5):
    for a, b in zip(ours, truth, strict=True):
        assert (a - b).norm() <= tolerance * b.norm()


# ---- what a call may ask for -----------------------------------------------------------------------


def test_the_remedy_is_named_where_warp_is_missing(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("physhdr.backend.rasterize.warp")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(BadValueError, match="warp-lang is not installed") as raised:
        rasterize(*gaussians(3)[:5], CAMERA, implementation="warp")
    assert "pip install warp-lang" in str(raised.value.hint)


@pytest.mark.long
def test_warp_is_imported_only_where_it_is_used():
    program = (
        "import sys; sys.modules['warp'] = None; import physhdr.backend.train.trainer, physhdr.backend.device"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT)


@pytest.mark.parametrize("channels", [32, 33, 70])
def test_any_number_of_channels(warp, channels):
    """More than a pass takes are drawn in several, whose gradients of the geometry add up."""
    tensors = gaussians(60, channels)
    drawn, ours = gradients("warp", tensors)
    expected, truth = gradients("reference", tensors, torch.float64)
    assert drawn.image.shape == (channels, CAMERA.height, CAMERA.width)
    assert_close([drawn.image, *ours], [expected.image, *truth])


def test_too_many_pairs_are_refused_before_memory_is(warp, monkeypatch):
    from physhdr.backend.rasterize.warp import lists

    monkeypatch.setattr(lists, "MOST_PAIRS", 100)
    with pytest.raises(BadValueError, match="200 Gaussians touch"):
        gradients("warp", gaussians())


# ---- tiles -----------------------------------------------------------------------------------------


def test_a_tile_is_listed_where_the_ellipse_reaches_a_pixel_of_it(warp):
    """Long slanted needles: nothing is missed, and hardly a tile is listed for nothing."""
    from physhdr.backend.rasterize.warp import stages

    camera = Camera(np.eye(4), 320, 240, 250.0, 250.0, 160.0, 120.0)
    tensors = gaussians(300, 3, seed=5)
    tensors[2] = torch.tensor([0.5, 0.01, 0.01]).repeat(300, 1)
    tensors[0][:, :2] *= 1.5
    lists = stages.draw(camera, stages.project(camera, *(t.contiguous() for t in tensors)), 3).lists
    starts, listed = lists.tile_starts.tolist(), lists.gaussians.tolist()
    found = {(g, t) for t in range(300) for g in listed[starts[t] : starts[t + 1]]}

    # Which tiles have a pixel with alpha ≥ 1/255, from the reference's projection, pixel by pixel.
    from physhdr.backend.rasterize.reference import project

    means, covariances, depth = project(*(t.double() for t in tensors[:3]), camera)
    y, x = torch.meshgrid(
        torch.arange(240.0).double() + 0.5, torch.arange(320.0).double() + 0.5, indexing="ij"
    )
    reached = set()
    for g in torch.nonzero(depth > 0.01)[:, 0].tolist():
        d = torch.stack([x - means[g, 0], y - means[g, 1]], dim=-1)
        power = -0.5 * torch.einsum("hwi,ij,hwj->hw", d, covariances[g].inverse(), d)
        shown = float(tensors[3][g]) * power.exp() >= 1 / 255
        reached |= {(g, t) for t in torch.unique((y // 16 * 20 + x // 16)[shown]).long().tolist()}
    assert reached <= found
    boxes = len(found) / len(reached)
    assert boxes < 1.1, f"{boxes:.2f} × as many pairs as there need be"


def test_pairs_that_were_counted_and_are_not_found_are_drawn_nowhere(warp, monkeypatch):
    """On a card the two kernels that find them may round otherwise."""
    from physhdr.backend.rasterize.warp import lists, stages

    tensors = gaussians()
    expected, truth = gradients("warp", tensors)
    make = lists.make_lists

    def with_three_more(depths, counts, *rest):
        return make(depths, counts + 3 * (counts > 0).int(), *rest)

    monkeypatch.setattr(stages, "make_lists", with_three_more)
    drawn, found = gradients("warp", tensors)
    assert torch.equal(drawn.image, expected.image)
    assert_close(found, truth, 1e-6)


# ---- bit for bit -----------------------------------------------------------------------------------


def test_sorted_accumulation_gives_the_same_gradients(warp, deterministic):
    tensors = gaussians()
    ours = gradients("warp", tensors)[1]
    assert_close(ours, gradients("reference", tensors, torch.float64)[1])


def test_sorted_accumulation_in_blocks(in_blocks, deterministic):
    """A tile's 256 threads in one block: every pair's sum is written by one of them."""
    tensors = gaussians(80, 3)
    first = gradients("warp", tensors)[1]
    assert_close(first, gradients("reference", tensors, torch.float64)[1])
    again = gradients("warp", tensors)[1]
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def test_with_sorted_accumulation_nothing_depends_on_the_order_of_blocks(warp, deterministic, monkeypatch):
    """Tiles one by one, the last first, as a card may take them: the same bits, and without it other ones."""
    from physhdr.backend.rasterize.warp import arrays, stages

    def bits():
        return gradients("warp", gaussians(400, 3))[1]

    launch = stages.launch

    def backwards(kernel, threads, arguments, device, block=256):
        if "draw_backward" not in kernel.key:
            launch(kernel, threads, arguments, device, block)
            return
        starts = arguments[0].tensor
        for tile in reversed(range(len(starts) - 1)):
            alone = torch.full_like(starts, 1 << 30)  # all other tiles' lists end before they begin
            alone[tile] = starts[tile]
            launch(kernel, threads, [arrays.Array(alone, arrays.wp.int32), *arguments[1:]], device, block)

    forwards = bits()
    with monkeypatch.context() as patch:
        patch.setattr(stages, "launch", backwards)
        assert all(torch.equal(a, b) for a, b in zip(forwards, bits(), strict=True))
        torch.use_deterministic_algorithms(False)
        other = bits()
    assert not all(torch.equal(a, b) for a, b in zip(bits(), other, strict=True))


# ---- the host --------------------------------------------------------------------------------------


def test_the_host_reads_one_number_back(warp, monkeypatch):
    from torch.utils._python_dispatch import TorchDispatchMode

    reads = []

    class Count(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            if func in (torch.ops.aten._local_scalar_dense.default, torch.ops.aten.nonzero.default):
                reads.append(func)
            return func(*args, **(kwargs or {}))

    from physhdr.backend.rasterize import warp as ours

    monkeypatch.setattr(ours, "refuse_what_is_not_finite", lambda tensors: None)  # as on a card
    tensors = gaussians()
    gradients("warp", tensors)
    with Count():
        gradients("warp", tensors)
    assert len(reads) == 1


def test_a_picture_that_nobody_holds_is_freed_at_once(warp):
    """Without waiting for the garbage collector: on a card its memory is the next picture's."""
    import gc
    import weakref

    gc.disable()
    try:
        leaves = [t.requires_grad_() for t in gaussians()]
        drawn = rasterize(*leaves[:5], CAMERA, screen_offsets=leaves[5], implementation="warp")
        kept = weakref.ref(drawn.image), weakref.ref(drawn.radii)
        drawn.image.sum().backward()
        del drawn
        assert kept[0]() is None and kept[1]() is None
    finally:
        gc.enable()


#: Pictures, cameras, numbers of Gaussians and of channels, so that launches find others than the last time.
SCENES = [
    (gaussians(200, 6, 0), CAMERA),
    (gaussians(31, 6, 1), CAMERA),
    (gaussians(31, 6, 2), Camera(np.eye(4), 90, 21, 33.0, 30.0, 44.0, 11.0)),
    (gaussians(200, 3, 3), CAMERA),
]


def test_what_is_launched_again_keeps_nothing_of_before(warp):
    def drawn(number: int) -> list[torch.Tensor]:
        tensors, camera = SCENES[number]
        picture, found = gradients("warp", tensors, camera=camera)
        return [picture.image.detach(), *found]

    first = [drawn(number) for number in range(len(SCENES))]
    for found, (tensors, camera) in zip(first, SCENES, strict=True):
        expected, _ = gradients("reference", tensors, camera=camera)
        assert torch.allclose(found[0], expected.image, atol=1e-5)
    for number in (2, 0, 3, 1, 0):
        assert all(torch.equal(a, b) for a, b in zip(drawn(number), first[number], strict=True))


def test_threads_draw_at_once(warp):
    """Without the way back: on the CPU, Warp's tile operations bear one thread at a time."""
    from concurrent.futures import ThreadPoolExecutor

    def drawn(number: int) -> torch.Tensor:
        tensors, camera = SCENES[number]
        return rasterize(*tensors[:5], camera, screen_offsets=tensors[5], implementation="warp").image

    alone = [drawn(number) for number in range(len(SCENES))]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # also between what is written into a launch and its start
    try:
        with ThreadPoolExecutor(4) as pool:
            numbers = [0, 1, 2, 3, 2, 1, 0, 3] * 8
            for number, found in zip(numbers, pool.map(drawn, numbers), strict=True):
                assert torch.equal(found, alone[number])
    finally:
        sys.setswitchinterval(interval)


def test_a_launch_keeps_no_tensor(warp):
    import weakref

    from physhdr.backend.rasterize.warp import projection
    from physhdr.backend.rasterize.warp.arrays import Array, launch, wp

    rows, sums = torch.rand(5, 2), torch.zeros(5, 2)
    order, counts, ends = torch.arange(5), torch.ones(5, dtype=torch.int32), torch.arange(1, 6)
    arguments = [
        *(Array(order, wp.int64), Array(counts, wp.int32), Array(ends, wp.int64)),
        *(Array(rows, wp.float32), Array(sums, wp.float32)),
    ]
    launch(projection.add_pairs, (5, 2), arguments, sums.device)
    assert torch.equal(sums, rows)
    kept = [weakref.ref(tensor) for tensor in (order, counts, ends, rows, sums)]
    del order, counts, ends, rows, sums, arguments
    assert all(reference() is None for reference in kept)


# ---- between threads -------------------------------------------------------------------------------


def returns_before_tile_operations(source: str) -> list[str]:
    """Kernels' lines that let a thread leave before a tile operation of the same kernel that it skips.

    A ``return`` anywhere before the last tile operation; a ``break`` or ``continue`` in a loop that has one.
    """

    def tile_operations(node: ast.AST) -> list[int]:
        return [
            call.lineno
            for call in ast.walk(node)
            if isinstance(call, ast.Call)
            and isinstance(call.func, ast.Attribute)
            and call.func.attr.startswith("tile")
        ]

    wrong = []
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef) or "kernel" not in ast.dump(
            ast.Module([ast.Expr(d) for d in function.decorator_list], [])
        ):
            continue
        last = max(tile_operations(function), default=0)
        wrong += [
            f"{function.name}:{node.lineno} return"
            for node in ast.walk(function)
            if isinstance(node, ast.Return) and node.lineno < last
        ]
        for loop in ast.walk(function):
            if isinstance(loop, ast.For | ast.While) and tile_operations(loop):
                wrong += [
                    f"{function.name}:{node.lineno} {type(node).__name__.lower()}"
                    for node in ast.walk(loop)
                    if isinstance(node, ast.Break | ast.Continue)
                ]
    return wrong


def test_no_thread_leaves_before_a_tile_operation():
    """A card's block would wait for it for ever; no run on a CPU shows that."""
    sources = list(KERNELS.glob("*.py"))
    assert any("wp.tile_sum(" in path.read_text() for path in sources)
    for path in sources:
        assert returns_before_tile_operations(path.read_text()) == [], path.name


@pytest.mark.parametrize("way_out", ["return", "break", "continue"])
def test_a_thread_that_leaves_is_found(way_out):
    source = f"""
@wp.kernel(enable_backward=False)
def draw(a: int):
    for i in range(10):
        if i > a:
            {way_out}
        b = wp.tile_sum(wp.tile(i))[0]
    return
"""
    assert len(returns_before_tile_operations(source)) == 1
    assert returns_before_tile_operations(source.replace(way_out, "pass", 1)) == []


#: Faults between the threads of a block, which only blocks show: what is replaced in tiles.py, by what.
MUTANTS = {
    "every thread adds for itself alone": (
        "whole = wp.tile_sum(wp.tile(part, preserve_type=True))\n"
        "                wp.tile_atomic_add(sums, whole, offset=targets[i])",
        "if wp.tid() % wp.block_dim() == 0:\n                    wp.atomic_add(sums, targets[i], part)",
    ),
    "every thread adds the block's sum": (
        "wp.tile_atomic_add(sums, whole, offset=targets[i])",
        "wp.atomic_add(sums, targets[i], whole[0])",
    ),
    "the vote is the first thread's": (
        "if wp.tile_max(wp.tile(mine))[0] > 0:",
        "if wp.tile_min(wp.tile(mine))[0] > 0:",
    ),
    "a pixel's last entry is the first thread's": (
        "last = wp.tile_max(wp.tile(end))[0]",
        "last = wp.tile_min(wp.tile(end))[0]",
    ),
}
PROGRAM = """
import sys, torch, warp
warp.config.enable_cpu_blocks = True
sys.path.insert(0, {folder!r})
import importlib.util
spec = importlib.util.spec_from_file_location("test_warp", {here!r})
tests = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tests)
import physhdr.backend.rasterize.warp.tiles as tiles
source = open(tiles.__file__).read()
assert source.count({old!r}) == 1
path = {folder!r} + "/tiles.py"
open(path, "w").write(source.replace({old!r}, {new!r}))
spec = importlib.util.spec_from_file_location(tiles.__name__, path)
broken = importlib.util.module_from_spec(spec)
sys.modules[tiles.__name__] = broken
spec.loader.exec_module(broken)
import physhdr.backend.rasterize.warp.stages as stages
stages.draw_backward_kernel = broken.draw_backward_kernel
tensors = tests.gaussians(60, 3)
truth = tests.gradients("reference", tensors, torch.float64)[1]
tests.assert_close(tests.gradients("warp", tensors)[1], truth)
"""


@pytest.mark.long
@pytest.mark.parametrize("fault", [None, *MUTANTS])
def test_blocks_on_the_cpu_show_faults_between_threads(in_blocks, fault, tmp_path):
    """Broken on purpose, in a process of its own; unbroken it passes."""
    old, new = MUTANTS[fault] if fault else ("def sums_type", "def sums_type")
    program = PROGRAM.format(folder=str(tmp_path), here=__file__, old=old, new=new)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    if fault is None:
        assert done.returncode == 0, done.stderr
    else:
        assert "AssertionError" in done.stderr, f"{fault} is not noticed: {done.stderr[-500:]}"


# ---- compiled for cards ----------------------------------------------------------------------------

#: At most so many registers a thread, by channels: backward's, the largest.
REGISTERS = {3: 64, 6: 80, 16: 112, 32: 200}


@pytest.mark.long
@pytest.mark.parametrize(
    ("architecture", "channels"),
    [(90, 6)]
    + [
        pytest.param(architecture, channels, marks=pytest.mark.long)
        for architecture in (75, 80, 86, 89, 90, 120)
        for channels in (3, 6, 16, 32)
        if (architecture, channels) != (90, 6)
    ],
)
def test_kernels_fit_into_the_registers_of_every_card(warp, architecture, channels, tmp_path, monkeypatch):
    """Compiled by NVRTC, which needs no card; a stack would be registers that were spilt to memory."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    from card import cubins

    found = [
        kernel
        for module, block in cubins.modules(channels)
        for kernel in cubins.compiled(module, block, architecture, tmp_path)
    ]
    assert len(found) == 7
    for kernel in found:
        assert kernel.stack == 0, kernel
        assert 16 <= kernel.registers <= REGISTERS[channels], kernel
        assert kernel.shared <= 4096, kernel


@pytest.mark.long
def test_other_kernels_fit_as_well(warp, tmp_path, monkeypatch):
    """Spherical harmonics, SSIM, networks; on the card with the fewest registers for a thread."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    from card import cubins

    for module, block in cubins.other_modules():
        for kernel in cubins.compiled(module, block, 75, tmp_path):
            assert kernel.stack == 0 and kernel.registers <= 128, kernel
