# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of members: what stays in its folder on Linux stays there on Windows, or is refused."""

import itertools
import ntpath
import zipfile
from pathlib import PurePosixPath, PureWindowsPath

import pytest

from physhdr.synth.archive import inner_path
from physhdr.synth.assets import Assets, _extracted
from physhdr.synth.errors import AssetError

PLAIN = [
    "models/sofa/sofa.obj",
    "sofa.obj",
    "models/.hidden",
    "a b/c-d_e(1).png",
    "Möbel/椅子.obj",
    "console/null.png",
    "models/com10.txt",
    "models/nul-1.png",
]
REFUSED = [
    "models/D:/evil/x",
    "D:/evil/x",
    "D:evil",
    "models/d:x",
    "C:\\evil",
    "models/..\\..\\evil",
    "\\\\server\\share\\x",
    "//server/share/x",
    "\\\\?\\C:\\x",
    "/etc/passwd",
    "../evil",
    "models/../../evil",
    "models/..",
    "models/.. /evil",
    "models/. ./evil",
    "models/.../evil",
    "./evil",
    "models//evil",
    "models/a:b",
    "models/a::$DATA",
    "models/x\0.obj",
    "models/x\n.obj",
    "models/CON",
    "nul/x.obj",
    "models/Aux.png",
    "models/com1.tar.gz",
    "models/LPT¹",
    "models/NUL .txt",
    "models/CONIN$",
    "models/trailing.",
    "models/trailing ",
    "trailing./x",
    "models/what?.png",
    "",
    "/",
]


@pytest.mark.parametrize("name", PLAIN)
def test_a_plain_name_is_kept_as_it_is(name):
    assert inner_path(name) == PurePosixPath(name)


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_leave_the_folder_somewhere_is_refused_everywhere(name):
    assert inner_path(name) is None


def test_whatever_is_accepted_stays_in_its_folder_on_windows():
    """All names of three pieces: joined as Windows joins, they are where they seem to be."""
    pieces = ["a", "..", ".", "/", "\\", ":", "C:", "NUL", " ", "b.c", "\0", "//"]
    folder = PureWindowsPath("C:/scratch/models")
    accepted = 0
    for pieces_of_one in itertools.product(pieces, repeat=3):
        name = "".join(pieces_of_one)
        path = inner_path(name)
        if path is None:
            continue
        accepted += 1
        joined = folder / str(path)
        assert joined.parts == (*folder.parts, *name.split("/")), name
        assert joined.drive == "C:" and ".." not in joined.parts, name
        assert not ntpath.isreserved(str(path)), name
    assert accepted > 10


@pytest.mark.parametrize(
    "evil", ["models/D:/evil/x", "models/..\\..\\evil.obj", "models/../../evil", "models/nul"]
)
def test_a_catalogue_with_such_a_member_is_refused_by_name(tmp_path, evil):
    path = tmp_path / "a.sh3f"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("PluginFurnitureCatalog.properties", "name#1=Sofa\nmodel#1=/models/sofa.obj")
        file.writestr("models/sofa.obj", "o nothing\n")
        file.writestr(evil, "must not be unpacked")
    [model] = Assets(tmp_path)._models
    scratch = tmp_path / "inner" / "scratch"
    scratch.mkdir(parents=True)
    with pytest.raises(AssetError) as refused:
        _extracted(model, scratch)
    assert repr(evil) in str(refused.value) and "a.sh3f" in str(refused.value)
    assert {each.name for each in tmp_path.rglob("*")} == {"a.sh3f", "inner", "scratch", "sofa.obj"}
