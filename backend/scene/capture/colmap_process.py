# SPDX-License-Identifier: GPL-3.0-or-later
"""A process of its own that runs COLMAP: ``python colmap_process.py JOB.json``. Needs pycolmap alone.

COLMAP's library ends the whole process where one of its checks fails; here that ends only this one.
``JOB.json`` is what ``structure.py`` writes. Says on stdout which step it is at, a line each; leaves the
largest reconstruction in ``folder/model`` and, in ``folder/pieces.json``, the names in every piece.
"""

import json
import shutil
import sys
from pathlib import Path

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
    folder = Path(job["folder"])
    database, pictures = folder / "database.db", folder / "pictures"

    say("features")
    reader = pycolmap.ImageReaderOptions(camera_model=job["camera_model"], camera_params=job["camera_params"])
    extraction = pycolmap.FeatureExtractionOptions(num_threads=job["threads"])
    # A picture of few pixels has few strong features; in a large one weak ones only take time.
    extraction.sift.peak_threshold *= 0.5 if job["small"] else 1.0
    pycolmap.extract_features(
        database, pictures, job["names"], pycolmap.CameraMode.SINGLE, reader, extraction, pycolmap.Device.cpu
    )

    exhaustive = len(job["names"]) <= MOST_FOR_EXHAUSTIVE
    say("matching each with each" if exhaustive else "matching neighbours in time")
    matching = pycolmap.FeatureMatchingOptions(num_threads=job["threads"])
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
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
