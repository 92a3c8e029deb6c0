# SPDX-License-Identifier: GPL-3.0-or-later
"""A process of its own that runs COLMAP: ``python colmap_process.py JOB.json``. Needs NumPy and pycolmap.

COLMAP's library ends the whole process where one of its checks fails; here that ends only this one.
Says on stdout which step it is at, a line each. Of a ``JOB.json`` that ``structure.py`` writes it leaves the
largest reconstruction in ``folder/model`` and, in ``folder/pieces.json``, the names in every piece; of one
that ``triangulate.py`` writes, which has ``pairs`` to match, the points in ``folder/points.npz``.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pycolmap

SEED = 0
#: Up to so many pictures each is matched with each other.
MOST_FOR_EXHAUSTIVE = 100
#: A longer capture matches each picture with so many that follow, and with some further ones.
SEQUENTIAL_OVERLAP = 12
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

    say("features")
    reader = pycolmap.ImageReaderOptions(camera_model=job["camera_model"], camera_params=job["camera_params"])
    pycolmap.extract_features(
        *(database, pictures, job["names"], pycolmap.CameraMode.SINGLE, reader, extraction_options(job)),
        pycolmap.Device.cpu,
    )

    exhaustive = len(job["names"]) <= MOST_FOR_EXHAUSTIVE
    say("matching each with each" if exhaustive else "matching neighbours in time")
    matching, verification = matching_options(job)
    if exhaustive:
        pycolmap.match_exhaustive(
            database, matching, verification_options=verification, device=pycolmap.Device.cpu
        )
    else:
        pairing = pycolmap.SequentialPairingOptions(overlap=SEQUENTIAL_OVERLAP)
        pycolmap.match_sequential(database, matching, pairing, verification, pycolmap.Device.cpu)

    pieces = []
    for lax in (False, True):
        say("mapping, with lax thresholds" if lax else "mapping")
        out = folder / f"attempt_{int(lax)}"
        out.mkdir()
        found = pycolmap.incremental_mapping(database, pictures, out, mapper_options(job, lax))
        pieces += [(out / str(number), piece) for number, piece in found.items()]
        if any(piece.num_reg_images() == len(job["names"]) for _, piece in pieces):
            break
    pieces.sort(key=lambda entry: (-entry[1].num_reg_images(), -entry[1].num_points3D()))
    names = [sorted(piece.image(k).name for k in piece.reg_image_ids()) for _, piece in pieces]
    (folder / "pieces.json").write_text(json.dumps(names))
    if pieces:
        shutil.copytree(pieces[0][0], folder / "model")


def triangulate(job: dict) -> None:
    """Points alone: every camera is known and stays as it is."""
    folder = Path(job["folder"])
    database, pictures = folder / "database.db", folder / "pictures"

    say("features")
    extraction = extraction_options(job)
    extraction.max_image_size = job["longest_side"]
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE")
    names = [picture["name"] for picture in job["pictures"]]
    pycolmap.extract_features(
        *(database, pictures, names, pycolmap.CameraMode.PER_IMAGE, reader, extraction, pycolmap.Device.cpu)
    )
    known = with_known_cameras(database, job["pictures"])

    say("matching")
    pairs = folder / "pairs.txt"
    pairs.write_text("".join(f"{one} {other}\n" for one, other in job["pairs"]))
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


def say(step: str) -> None:
    sys.stdout.write(step + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))
