# SPDX-License-Identifier: GPL-3.0-or-later
"""A process of its own that runs COLMAP: ``python colmap_process.py JOB.json``. Needs NumPy and pycolmap.

COLMAP's library ends the whole process where one of its checks fails; here that ends only this one.
Says on stdout which step it is at, a line each, and, after a tab, which share of it is done. It ends when its
stdin does: whoever started it is gone then. Of a ``JOB.json`` that ``structure.py`` writes it leaves the
largest reconstruction in ``folder/model`` and, in ``folder/pieces.json``, the names in every piece; of one
that ``triangulate.py`` writes, which has ``pairs`` to match, the points in ``folder/points.npz``.
"""

import itertools
import json
import os
import shutil
import signal
import sys
import threading
from pathlib import Path

import numpy as np
import pycolmap

SEED = 0
#: Pictures and pairs between two lines that say how far it is.
PICTURES_AT_ONCE, PAIRS_AT_ONCE = 8, 64
#: What the second attempt accepts, for small baselines and few features: degrees, matches, matches.
LAX_ANGLE, LAX_FIRST_PAIR, LAX_POSE = 4.0, 40, 15


def main(job: dict) -> None:
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
    pycolmap.set_random_seed(SEED)
    if "pairs" in job:
        triangulate(job)
    else:
        recover(job)


def recover(job: dict) -> None:
    """Cameras and points."""
    folder = Path(job["folder"])
    database, pictures = folder / "database.db", folder / "pictures"

    names = [name for group in job["groups"] for name in group["names"]]
    extract(job, database, pictures, len(names))
    match(job, database, folder)

    pieces = []
    for lax in (False, True):
        say(_mapping(lax))
        out = folder / f"attempt_{int(lax)}"
        out.mkdir()
        placed = itertools.count(3)  # two begin it
        found = pycolmap.incremental_mapping(
            database,
            pictures,
            out,
            mapper_options(job, lax),
            next_image_callback=lambda placed=placed, lax=lax: say(_mapping(lax), next(placed) / len(names)),
        )
        pieces += [(out / str(number), piece) for number, piece in found.items()]
        if any(piece.num_reg_images() == len(names) for _, piece in pieces):
            break
    pieces.sort(key=lambda entry: (-entry[1].num_reg_images(), -entry[1].num_points3D()))
    placed_names = [sorted(piece.image(k).name for k in piece.reg_image_ids()) for _, piece in pieces]
    (folder / "pieces.json").write_text(json.dumps(placed_names), encoding="utf-8")
    if pieces:
        shutil.copytree(pieces[0][0], folder / "model")


def _mapping(lax: bool) -> str:
    return "mapping, with lax thresholds" if lax else "mapping"


def extract(job: dict, database: Path, pictures: Path, total: int) -> None:
    """Features; the pictures of each group share a camera."""
    say("features")
    done = 0
    for group in job["groups"]:
        reader = pycolmap.ImageReaderOptions(
            camera_model=job["camera_model"], camera_params=group["camera_params"]
        )
        if job["masks"]:
            reader.mask_path = job["masks"]
        names = group["names"]
        for first in range(0, len(names), PICTURES_AT_ONCE):
            some = names[first : first + PICTURES_AT_ONCE]
            pycolmap.extract_features(
                *(database, pictures, some, pycolmap.CameraMode.SINGLE, reader, extraction_options(job)),
                pycolmap.Device.cpu,
            )
            if first == 0:
                with pycolmap.Database.open(database) as opened:
                    images = {image.name: image for image in opened.read_all_images()}
                reader.existing_camera_id = images[some[0]].camera_id
            done += len(some)
            say("features", done / total)


def match(job: dict, database: Path, folder: Path) -> None:
    """The pairs of ``job["match"]``."""
    say("matching")
    matching, verification = matching_options(job)
    pairs, total = folder / "pairs.txt", len(job["match"])
    at_once = max(PAIRS_AT_ONCE, total // 20)
    for first in range(0, total, at_once):
        some = job["match"][first : first + at_once]
        pairs.write_text("".join(f"{one} {other}\n" for one, other in some), encoding="utf-8", newline="\n")
        pairing = pycolmap.ImportedPairingOptions(match_list_path=str(pairs))
        pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)
        say("matching", min(1.0, (first + at_once) / total))


def triangulate(job: dict) -> None:
    """Points alone: every camera is known and stays as it is."""
    folder = Path(job["folder"])
    database, pictures = folder / "database.db", folder / "pictures"

    say("features")
    extraction = extraction_options(job)
    extraction.max_image_size = job["longest_side"]
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE")
    if job["masks"]:
        reader.mask_path = job["masks"]
    names = [picture["name"] for picture in job["pictures"]]
    pycolmap.extract_features(
        *(database, pictures, names, pycolmap.CameraMode.PER_IMAGE, reader, extraction, pycolmap.Device.cpu)
    )
    known = with_known_cameras(database, job["pictures"])

    say("matching")
    pairs = folder / "pairs.txt"
    pairs.write_text(
        "".join(f"{one} {other}\n" for one, other in job["pairs"]), encoding="utf-8", newline="\n"
    )
    matching, verification = matching_options(job)
    pairing = pycolmap.ImportedPairingOptions(match_list_path=str(pairs))
    pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)

    say("triangulating")
    out = folder / "model"
    out.mkdir()
    options = mapper_options(job, lax=False)
    found = pycolmap.triangulate_points(known, database, pictures, out, True, options, False)
    write_points(found, {name: number for number, name in enumerate(names)}, folder / "points.npz")


def with_known_cameras(database: Path, pictures: list[dict]) -> pycolmap.Reconstruction:
    """The pictures at their places, in a reconstruction without points; the database learns the cameras."""
    known = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        images = {image.name: image for image in opened.read_all_images()}
        for picture in pictures:
            image = images[picture["name"]]
            camera = opened.read_camera(image.camera_id)
            camera.params, camera.has_prior_focal_length = picture["camera"], True
            opened.update_camera(camera)
            known.add_camera_with_trivial_rig(camera)
            keypoints = opened.read_keypoints(image.image_id)[:, :2].astype(np.float64)
            placed = pycolmap.Image(
                name=image.name, keypoints=keypoints, camera_id=image.camera_id, image_id=image.image_id
            )
            pose = pycolmap.Rigid3d(np.array(picture["world_to_camera"]))
            known.add_image_with_trivial_frame(placed, pose)
    return known


def write_points(found: pycolmap.Reconstruction, numbers: dict[str, int], path: Path) -> None:
    """Points, and every observation: the point, the picture's number, the place in it (pixels)."""
    points = [found.points3D[k] for k in sorted(found.points3D)]
    observed, picture, place = [], [], []
    for number, point in enumerate(points):
        for element in point.track.elements:
            image = found.image(element.image_id)
            observed.append(number)
            picture.append(numbers[image.name])
            place.append(image.points2D[element.point2D_idx].xy)
    np.savez(
        path,
        positions=np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        errors=np.array([point.error for point in points], np.float64),
        observed=np.array(observed, np.int64),
        picture=np.array(picture, np.int64),
        place=np.array(place, np.float64).reshape(-1, 2),
    )


def extraction_options(job: dict) -> pycolmap.FeatureExtractionOptions:
    options = pycolmap.FeatureExtractionOptions(num_threads=job["threads"])
    # A picture of few pixels has few strong features; in a large one weak ones only take time.
    options.sift.peak_threshold *= 0.5 if job["small"] else 1.0
    return options


def matching_options(job: dict) -> tuple[pycolmap.FeatureMatchingOptions, pycolmap.TwoViewGeometryOptions]:
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    return pycolmap.FeatureMatchingOptions(num_threads=job["threads"]), verification


def mapper_options(job: dict, lax: bool) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions(
        min_model_size=2, num_threads=job["threads"], random_seed=SEED
    )
    options.mapper.random_seed = SEED
    options.triangulation.random_seed = SEED
    if lax:
        options.mapper.init_min_tri_angle = LAX_ANGLE
        options.mapper.init_min_num_inliers = LAX_FIRST_PAIR
        options.mapper.abs_pose_min_num_inliers = LAX_POSE
    return options


def say(step: str, share: float | None = None) -> None:
    sys.stdout.write(step + ("\n" if share is None else f"\t{share:.4f}\n"))
    sys.stdout.flush()


def end_with_stdin() -> None:
    """End this process when its stdin ends: of somebody who was killed nobody else tells."""
    while os.read(0, 1):  # sys.stdin's own lock, held here, would abort a process that ends in order
        pass
    os._exit(1)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # CTRL-C in a terminal is the other process's to act on
    threading.Thread(target=end_with_stdin, daemon=True).start()
    main(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
