# SPDX-License-Identifier: GPL-3.0-or-later
"""Brackets found by name, and by order, pattern and pauses; what is not plain is refused."""

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.scene.capture.brackets import find_brackets
from physhdr.backend.scene.capture.choice import best_step, clipped_share, thinned
from physhdr.backend.scene.capture.photos import Photo
from physhdr.backend.scene.capture.structure import pairs_in_time, pairs_of_places
from physhdr.bridge.errors import PhysHDRError


def shots(evs, names=None, pauses=None):
    """Photos and their seconds: exposures in EV, names, seconds between the starts of one and the next."""
    moment, photos, seconds = datetime(2026, 5, 1), [], {}
    for k, ev in enumerate(evs):
        name = names[k] if names else f"IMG_{k:04d}.jpg"
        photos.append(Photo(Path(name), 30, 20, moment if pauses else None, 2.0**ev))
        seconds[name] = 2.0**ev
        moment += timedelta(seconds=pauses[k] if pauses else 0)
    return photos, seconds


def poses(found):
    return [[photo.path.stem for photo in pose.photos] for pose in found.poses]


def refused(*arguments, **options):
    with pytest.raises(PhysHDRError) as caught:
        find_brackets(*arguments, **options)
    assert caught.value.hint
    return str(caught.value)


def test_automatic_bracketing_is_sorted_by_exposure():
    found = find_brackets(*shots([0, -2, 2] * 4))
    assert poses(found)[0] == ["IMG_0001", "IMG_0000", "IMG_0002"] and len(found.poses) == 4
    assert found.evs == [-2, 0, 2] and found.drift == 0.0


def test_four_equal_steps_are_not_taken_for_two():
    assert find_brackets(*shots([-3, -1, 1, 3] * 3)).length == 4


def test_automatic_exposure_between_brackets():
    """The pattern counts, not the exposures: the camera chose another base for each pose."""
    found = find_brackets(*shots([b + e for b in (0, 0.7, -1.0, 0.3) for e in (0, -2, 2)]))
    assert found.length == 3 and found.drift == pytest.approx(1.7)


def test_one_exposure_is_a_capture_of_one_each():
    assert poses(find_brackets(*shots([1.0] * 5))) == [[f"IMG_{k:04d}"] for k in range(5)]


def test_time_goes_before_names_and_names_settle_ties():
    """The camera's counter runs over from 9999 to 0000; its clock knows whole seconds only."""
    names = ["D_9998.jpg", "D_9999.jpg", "D_0000.jpg", "D_0001.jpg"]
    found = find_brackets(*shots([0, 2, 0, 2], names, pauses=[1, 30, 0, 30]))
    assert poses(found) == [["D_9998", "D_9999"], ["D_0000", "D_0001"]]


def test_names_of_pose_and_step():
    names = [f"{pose}_{k}.png" for pose in ("desk", "door 10", "door 9") for k in (2, 0, 1)]
    found = find_brackets(*shots([2, -2, 0] * 3, names))
    assert "by name" in found.how
    assert poses(found) == [[f"{pose}_{k}" for k in (0, 1, 2)] for pose in ("desk", "door 9", "door 10")]


@pytest.mark.parametrize("count", [6, 12])
def test_series_of_single_photos_are_no_brackets_by_name(count):
    """Automatic exposure, room by room: more photos than brackets have, or one exposure twice."""
    names = [f"{room}_{k:02d}.jpg" for room in ("bath", "kitchen") for k in range(count)]
    random = np.random.default_rng(count)
    evs = np.round(3 * np.cumsum(random.normal(0.0, 0.3, 2 * count))) / 3
    if count == 12:
        evs = evs + np.arange(2 * count) * 0.3  # no exposure comes again
    found = find_brackets(*shots(list(evs), names))
    assert found.length == 1 and len(found.poses) == 2 * count and "automatic" in found.how
    same = find_brackets(*shots([1.0] * 2 * count, names))  # frames of two videos, of one exposure as asked
    assert same.length == 1 and len(same.poses) == 2 * count
    assert "of the same exposure" in refused(*shots([1.0] * 2 * count, names), by="names")


def test_named_brackets_of_which_one_has_an_exposure_twice_are_refused():
    """They do not pass for single photos: the shortest time of the camera was reached."""
    names = [f"{place}_{k}.jpg" for place in "abcdefgh" for k in range(3)]
    evs = [-2, 0, 2] * 8
    evs[4] = -2
    assert "not plain which of the 24" in refused(*shots(evs, names))


def test_one_photo_a_place_says_why():
    assert find_brackets(*shots([1.0] * 5)).how == "one photo a place, all of one exposure"
    assert find_brackets(*shots([0, 2, 4, 6]), length=1).how == "one photo a place, as asked"


def test_a_missing_photo_is_found_where_it_is_missing():
    evs = [0, -2, 2] * 5
    del evs[7]  # the third bracket's −2
    message = refused(*shots(evs))
    assert (
        "come again after 3, 3, 2, 3, 3 photos" in message and "IMG_0006.jpg 1 s, IMG_0007.jpg 4 s" in message
    )
    assert "--bracket" in message


def test_pauses_show_brackets_that_are_shifted():
    """One photo is missing at the start and one at the end: the pattern repeats, but across poses."""
    evs, pauses = [-2, 2] + [0, -2, 2] * 3 + [0], [1, 20] + [1, 1, 20] * 3 + [1]
    message = refused(*shots(evs, pauses=pauses))
    assert "missing or stray at the start" in message and "IMG_0002.jpg" in message
    assert find_brackets(*shots([0, -2, 2] * 4, pauses=[1, 1, 20] * 4)).length == 3


def test_a_long_exposure_is_no_pause():
    assert find_brackets(*shots([0, 3, 5] * 3, pauses=[2, 9, 38] * 3)).length == 3


def test_automatic_exposure_without_brackets_is_a_photo_a_place():
    """Eleven photos of 1/500 to 1/1250 s, as they came, and twelve that look into the light and out of it."""
    times = [800, 640, 640, 500, 640, 800, 1000, 1250, 1000, 1000, 800]
    found = find_brackets(*shots([-np.log2(time) for time in times]))
    assert found.length == 1 and len(found.poses) == 11 and "automatic" in found.how
    assert found.stops == pytest.approx(np.log2(2.5))
    drifting = [0, 1.0, 1.7, 0.3, -1.3, -1.0, 0.3, 2.0, 1.7, 2.3, 0.7, -0.3]
    assert find_brackets(*shots(drifting)).length == 1


def test_a_camera_that_says_it_was_bracketing_is_believed():
    photos, seconds = shots([0, 0.3, 0.7] * 2 + [0, 0.3])
    photos = [replace(photo, auto_bracket=True) for photo in photos]
    assert "not plain which of the 8" in refused(photos, seconds)


@pytest.mark.parametrize("drift", [0.0, 0.5])
@pytest.mark.parametrize("pattern", [[0, -2, 2], [-2, 0, 2], [0, -1, 1], [0, -2, -1, 1, 2], [0, 2]])
def test_a_missing_photo_never_passes_for_automatic_exposure(pattern, drift):
    random = np.random.default_rng(3)
    for _ in range(20):
        evs = [round(3 * base) / 3 + ev for base in random.normal(0, drift, 12) for ev in pattern]
        assert find_brackets(*shots(evs)).length == len(pattern)
        del evs[random.integers(1, len(evs) - 1)]
        refused(*shots(evs))


def test_a_damaged_photo_keeps_its_place_and_costs_its_bracket():
    """By order, with and without the camera's clock, and by name."""
    for pauses in (None, [1, 1, 20] * 4):
        photos, seconds = shots([0, -2, 2] * 4, pauses=pauses)
        photos[4] = Photo(photos[4].path, 0, 0)
        del seconds[photos[4].name]
        found = find_brackets(photos, seconds)
        assert found.length == 3 and [pose[1] for pose in poses(found)] == [
            "IMG_0000",
            "IMG_0006",
            "IMG_0009",
        ]
    photos, seconds = shots([0, 2] * 3, [f"{pose}_{k}.png" for pose in "abc" for k in range(2)])
    del seconds["b_1.png"]
    assert poses(find_brackets(photos, seconds)) == [["a_0", "a_1"], ["c_0", "c_1"]]


def damaged(photos, seconds, *numbers):
    """These photos have no exposure."""
    return photos, {photo.name: seconds[photo.name] for k, photo in enumerate(photos) if k not in numbers}


def test_damaged_photos_fit_no_shorter_bracket():
    """One before each bracket of three: nothing says that each two photos are a bracket."""
    photos, seconds = damaged(*shots([9, -4, 0, 4] * 4), 0, 4, 8, 12)
    assert "not plain which of the 16" in refused(photos, seconds)
    photos, seconds = damaged(*shots([9, -4, 0, 4] * 4), 4)
    assert [len(pose) for pose in poses(find_brackets(photos, seconds))] == [4, 4, 4]


def test_a_bracket_whose_first_photo_is_damaged_is_compared_by_the_others():
    """Under automatic exposure each is compared with its own first photo."""
    evs = [base + ev for base in (0, 0.7, -1.0, 0.3, 1.3) for ev in (0, -2, 2)]
    found = find_brackets(*damaged(*shots(evs), 3))
    assert [pose[1] for pose in poses(found)] == ["IMG_0000", "IMG_0006", "IMG_0009", "IMG_0012"]
    evs[4] -= 1.0  # not of this bracket
    photos, seconds = damaged(*shots(evs), 3)
    assert "not plain which of the 15" in refused(
        [replace(photo, auto_bracket=True) for photo in photos], seconds
    )


def test_where_each_bracket_has_a_damaged_photo_they_are_named():
    photos, seconds = shots([0, 2] * 3, [f"{pose}_{k}.png" for pose in "abc" for k in range(2)])
    for name in ("a_1.png", "b_0.png", "c_1.png"):
        del seconds[name]
    message = refused(photos, seconds)
    assert "a damaged photo: a_1.png, b_0.png, c_1.png" in message and "Copy them again" in message


def test_hand_held_brackets_are_photos_by_themselves_that_know_their_place():
    found = find_brackets(*shots([0, -2, 2] * 3)).apart()
    assert found.length == 1 and found.place_of == (0, 0, 0, 1, 1, 1, 2, 2, 2)
    assert poses(found)[:3] == [["IMG_0001"], ["IMG_0000"], ["IMG_0002"]] and found.stops == 4.0


def test_which_photos_are_matched():
    """Few: all; many: the same exposure with what follows it, and the next exposure from place to place."""
    assert len(pairs_in_time(range(20))) == 190
    long = pairs_in_time(range(300))
    assert (5, 6) in long and (5, 17) in long and (5, 5 + 128) in long and (5, 5 + 100) not in long
    places, steps = [k // 3 for k in range(300)], [k % 3 for k in range(300)]
    held = pairs_of_places(places, steps)
    assert (0, 3) in held and (0, 1) in held and (0, 4) in held and (0, 2) not in held
    assert len(held) == len(set(held)) and all(one < other for one, other in held) and len(held) < 300 * 20


def test_what_is_not_plain_the_user_says():
    photos, seconds = shots([0, 2, 0.7, 2.7, 0, 2, 0.7, 2.7])  # two of two poses, or four of one
    assert find_brackets(photos, seconds, length=2).length == 2
    assert find_brackets(photos, seconds, length=4).length == 4
    assert "cannot be 3 to a pose" in refused(photos, seconds, length=3)
    assert "of the same exposure" in refused(*shots([0, 0, 1, 1]), length=2)
    assert len(find_brackets(*shots([0, 1, 0.4, 2.2, 5]), by="none").poses) == 5
    names = ["a_0.jpg", "a_1.jpg", "b_0.jpg", "b_1.jpg", "c_1.jpg"]
    assert "pose 'c' has 1 photos (c_1.jpg), most poses have 2" in refused(
        *shots([0, 1, 0, 1, 1], names), by="names"
    )


def test_long_brackets_are_thinned_evenly():
    found, steps = thinned(find_brackets(*shots(list(range(9)) * 2)))
    assert steps == (0, 2, 4, 6, 8) and found.evs == [0, 2, 4, 6, 8]
    assert thinned(find_brackets(*shots([0, 1, 2] * 2)))[1] == (0, 1, 2)


def test_the_best_exposed_step():
    pixels = np.full((10, 10, 3), 100, np.uint8)
    pixels[:2], pixels[5:, :, 1], pixels[5:6, :, 1] = 3, 255, 249
    assert clipped_share(pixels) == pytest.approx(0.6)
    assert best_step(np.array([[0.4, 100.0], [0.05, 200.0], [0.3, 118.0]])) == 1  # the fewest clipped
    assert best_step(np.array([[0.0, 20.0], [0.004, 90.0], [0.2, 118.0]])) == 1  # as good, and less dark
