"""One rendering, many cameras: the same bytes as one at a time, and light that adds up."""

from __future__ import annotations

import functools
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.datasets.simulated import SOURCES, read_truth
from foreglow.datasets.simulated.light_maps import CELL_PX, decoded, light_map_path
from foreglow.datasets.simulated.shares import read_shares
from foreglow.files import read_bytes
from foreglow.lab.simulation import (
    DatasetConfig,
    Drive,
    Scene,
    Target,
    drive_exposures,
    drive_frames,
    side_by_side,
    simulate_dataset,
    simulate_datasets,
)
from foreglow.lab.simulation.camera.profile import (
    CameraProfile,
    EncoderSpec,
    ExposureSpec,
    ImagerSpec,
    LensSpec,
    StreakSpec,
    VeilSpec,
    ViewSpec,
    read_profile,
)
from foreglow.lab.simulation.drive import DriveCamera, camera_of
from foreglow.lab.simulation.drive import _imager as imager_of
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.labels.shares import box_shares
from foreglow.lab.simulation.light.render import QUALITIES
from foreglow.lab.simulation.moment import Moments
from foreglow.lab.simulation.scenes.scene import SensorSpec, VehicleSpec
from foreglow.lab.simulation.variants import AS_IT_IS, Variant, draw_variants
from foreglow.parallel import Local
from foreglow.photometry import read_headlamps
from tests.lab.simulation.test_drive import scene

pytestmark = pytest.mark.renderer

OWN = CameraProfile(
    name="own",
    view=ViewSpec(width_px=128, height_px=72),
    exposure=ExposureSpec(metering="average", readout_s=0.02),
    encoder=EncoderSpec(kbps=500.0),
)
DAY, NIGHT = read_profile("pvdn_day"), read_profile("pvdn_night")
AHEAD = VehicleSpec(lane="own", timetable=((0.0, 45.0), (10.0, 245.0)))
ONCOMING = VehicleSpec(timetable=((0.0, 90.0), (10.0, -110.0)))


def lit() -> Scene:
    """A car comes towards us, another is ahead, and we have the matrix beam."""
    given = scene(vehicles=(ONCOMING, AHEAD))
    return given.model_copy(update={"ego": given.ego.model_copy(update={"beam": "matrix"})})


@functools.cache
def exposed(*profiles: CameraProfile) -> tuple[tuple[DriveFrame, ...], ...]:
    return tuple(drive_exposures(lit(), profiles, num_variants=2, quality="fast"))


def test_a_camera_that_adds_nothing_is_the_scenes_own_but_for_its_quick_lens() -> None:
    plain = CameraProfile(name="plain", cycle="day", imager=ImagerSpec(model="scene"))
    for known, (frame,) in zip(drive_frames(lit(), "fast"), drive_exposures(lit(), (plain,), 1, "fast"), strict=True):
        differences = cv2.absdiff(frame.frame.image, known.frame.image)
        assert float(differences.max()) <= 5  # beside lamps in so small an image, whose coarse grid is no coarser
        assert float(differences.mean()) < 0.05
        assert len(frame.vehicles) == len(known.vehicles)


def test_cameras_do_not_depend_on_each_other_or_their_order() -> None:
    for both, alone in zip(exposed(OWN, DAY), exposed(DAY), strict=True):
        for each, again in zip(both[2:], alone, strict=True):
            assert np.array_equal(each.frame.image, again.frame.image)
    for both, turned in zip(exposed(OWN, DAY), drive_exposures(lit(), (DAY, OWN), 2, "fast"), strict=True):
        for each, again in zip(both, (*turned[2:], *turned[:2]), strict=True):
            assert np.array_equal(each.frame.image, again.frame.image)
            assert each.to_line() == again.to_line()


def test_labels_lie_in_the_cameras_own_image() -> None:
    own, day = exposed(OWN, DAY)[0][0], exposed(OWN, DAY)[0][2]
    assert own.frame.image.shape == (72, 128)
    assert own.depth_m.shape == (72, 128)
    for vehicle, whole in zip(own.vehicles, day.vehicles, strict=True):
        for lamp, there in zip(vehicle.lamps, whole.lamps, strict=True):
            assert lamp.position_px[0] == pytest.approx(there.position_px[0] * 0.8)
            assert lamp.position_px[1] == pytest.approx((there.position_px[1] - 15) * 0.8)
    lamps = [artifact for vehicle in own.vehicles for artifact in vehicle.artifacts if artifact.is_direct]
    assert lamps
    x, y = lamps[0].position_px
    around = own.frame.image[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3]
    assert around.max() > 2 * np.median(own.frame.image)


def moment(given: Scene, variant: Variant = AS_IT_IS) -> DriveCamera:
    """The night camera after the first moment of a scene."""
    rendered = camera_of(given.camera)
    headlamps = read_headlamps()
    moments = Moments(given, rendered, QUALITIES["fast"], headlamps, is_split=True)
    camera = DriveCamera(given, rendered, NIGHT, variant)
    camera.frame(moments, moments.at(0, np.ones((2, headlamps.num_leds))))
    return camera


@functools.cache
def night_light() -> NDArray[np.float32]:
    camera = moment(lit())
    assert camera.latest is not None
    return camera.latest.by_source()


def dark(given: Scene, number: int) -> Scene:
    """The scene with one vehicle's lamps off."""
    vehicles = [
        vehicle.model_copy(update={"beam": "off"}) if index == number else vehicle
        for index, vehicle in enumerate(given.vehicles)
    ]
    return given.model_copy(update={"vehicles": tuple(vehicles)})


@pytest.mark.parametrize("number", [0, 1])
def test_shares_are_those_of_renderings_without_the_vehicle(number: int) -> None:
    others_dark = dark(lit(), 1 - number)
    camera, taken_out = moment(others_dark).latest, moment(dark(others_dark, number)).latest
    assert camera is not None
    assert taken_out is not None
    light, without = camera.by_source(), taken_out.by_source()
    nothing = np.zeros_like(without[0])
    rendered = np.stack([light.sum(0) - without.sum(0), nothing, nothing, nothing, *without[4:]])
    corners = np.array([(x, y) for x in range(4, 140, 12) for y in range(40, 100, 12)], np.int32)
    boxes = np.concatenate([corners, corners + np.array([16, 12])], axis=1).astype(np.int32)
    shares, expected = box_shares(light, boxes), box_shares(rendered, boxes)
    np.testing.assert_allclose(shares[:, :4].sum(1), expected[:, 0], atol=0.02)
    np.testing.assert_allclose(shares.sum(1), 1.0, rtol=1e-5)
    assert expected[:, 0].max() > 0.1
    is_front, is_rear = shares[:, [0, 2]].sum(1) > 0.05, shares[:, [1, 3]].sum(1) > 0.05
    assert (is_rear if number else is_front).any()
    assert number == 1 or not is_rear.any()


def test_light_of_lamps_that_are_off_is_nowhere() -> None:
    camera = moment(dark(dark(lit(), 0), 1)).latest
    assert camera is not None
    light = camera.by_source()
    assert float(light[:4].max()) == 0.0
    assert float(light[SOURCES.index("own")].max()) > 0.01


def test_a_variant_without_a_vehicle_is_a_scene_without_it() -> None:
    off, never = moment(lit(), Variant(off=(0,))).latest, moment(dark(lit(), 0)).latest
    assert off is not None
    assert never is not None
    np.testing.assert_allclose(off.by_source(), never.by_source(), atol=2e-5)


def test_a_vehicle_out_of_sight_lights_what_it_lit() -> None:
    variant = Variant(unseen=(0, 1))
    camera, known = moment(lit(), variant), night_light()
    assert camera.latest is not None
    light = camera.latest.by_source()
    assert float(known[:2].max()) > 0.01
    assert float(light[:2].max()) == 0.0
    np.testing.assert_allclose(light[2:], known[2:], atol=2e-4)  # lamps are subtracted from the sum
    moments = Moments(lit(), camera_of(lit().camera), QUALITIES["fast"], headlamps := read_headlamps(), is_split=True)
    labelled = camera.frame(moments, moments.at(0, np.ones((2, headlamps.num_leds))))
    lamps = [lamp for vehicle in labelled.vehicles for lamp in vehicle.lamps]
    assert lamps
    assert all(lamp.visible_share == 0.0 for lamp in lamps)
    artifacts = [artifact for vehicle in labelled.vehicles for artifact in vehicle.artifacts]
    assert artifacts
    assert not any(artifact.is_direct for artifact in artifacts)


def test_a_variant_of_our_light_is_a_multiple_of_its_layer() -> None:
    changed = moment(lit(), Variant(low=0.5, high=0.5)).latest
    assert changed is not None
    light = changed.by_source()
    np.testing.assert_allclose(light[4], 0.5 * night_light()[4], atol=2e-5)
    np.testing.assert_allclose(light[:4], night_light()[:4], atol=2e-5)


def test_no_variant_scatters_more_light_than_there_is() -> None:
    """Whatever its lens: the exact one with a wide middle, or a windscreen with strong streaks."""
    starry = LensSpec(veils=(VeilSpec(share=0.1),), streaks=(StreakSpec(share=0.2),) * 4)
    wide = lit().model_copy(update={"sensor": SensorSpec(middle_share=0.9, tail_share=0.1)})
    for given, profile in ((lit(), OWN.model_copy(update={"lens": starry})), (wide, None)):
        imager = imager_of(given, camera_of(given.camera), profile, Variant(veil=4.0))
        seen = imager.optics.spread(np.ones((given.camera.height_px, given.camera.width_px), np.float32))
        assert 0.0 < seen.min() <= seen.max() < 1.1


def test_variants_are_drawn_by_their_own_number() -> None:
    few, many = draw_variants(lit(), 2), draw_variants(lit(), 5)
    assert many[:2] == few
    assert few[0] == Variant()
    assert len(set(many)) == 5


def files(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def written(out: Path, profiles: tuple[CameraProfile, ...], jobs: int = 1) -> None:
    scenes = [lit(), lit().model_copy(update={"seed": 4})]
    config = DatasetConfig.of(seed=7, split="train", cycle="day", quality="fast")
    targets = [Target(out / profile.name, config.exposed_for(profile, ("foreglow",))) for profile in profiles]
    expose = functools.partial(
        drive_exposures, profiles=profiles, num_variants=2, quality="fast", presets=("foreglow",)
    )
    simulate_datasets(targets, scenes, expose, num_variants=2, workers=Local(jobs))


@pytest.mark.slow
@pytest.mark.process
def test_same_bytes_at_any_jobs_and_order_also_after_a_loss(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    written(tmp_path / "one", (OWN, DAY))
    written(tmp_path / "two", (DAY, OWN), jobs=2)
    expected = files(tmp_path / "one")
    assert files(tmp_path / "two") == expected
    root = tmp_path / "two" / "own" / "night" / "train"
    for path in sorted((root / "simulation" / "S00003").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    (root / "simulation" / "S00003").rmdir()
    written(tmp_path / "two", (OWN, DAY))
    assert files(tmp_path / "two") == expected
    truth = read_truth(root)
    assert truth.sequence_ids == (1, 2, 3, 4)
    rows = list(read_shares(root / "simulation" / "S00001" / "shares.parquet"))
    assert rows
    assert {image_id // 10_000 for image_id, _ in rows} == {1}
    sequence = root / "simulation" / "S00001"
    for image_id in {image_id for image_id, _ in rows}:
        path = light_map_path(sequence, image_id)
        light = decoded(np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8))
        image = np.asarray(cv2.imread(str(root / "images" / "S00001" / path.name), cv2.IMREAD_GRAYSCALE), np.float64)
        height, width = (CELL_PX * size for size in light.shape[1:])
        means = image[:height, :width].reshape(light.shape[1], CELL_PX, light.shape[2], CELL_PX).mean((1, 3))
        assert np.corrcoef(means.ravel(), np.log(light.sum(0).ravel() + 1e-3))[0, 1] > 0.5
    assert b'"variant"' in read_bytes(root / "simulation" / "S00002" / "scene.json", 10_000_000)


def test_a_data_set_without_profiles_has_no_word_of_them(tmp_path: Path) -> None:
    drive = functools.partial(drive_frames, quality="fast")
    root = simulate_dataset(tmp_path, [lit()], drive).root
    text = (root / "simulation" / "S00001" / "scene.json").read_text()
    assert not {word for word in ("variant", "presets", '"camera": null') if word in text}


def test_relit_moments_are_what_would_have_been_rendered() -> None:
    """Other levels are arithmetic on a rendering, up to where it takes its samples of edges."""
    given = lit()
    levels = np.ones((2, 84))
    levels[:, 20:45] = 0.1
    source = Drive(given, "fast")
    source.set_led_levels(levels)
    shone = [levels, np.zeros_like(levels), levels]
    for known, (bright, dark, again) in zip(
        source.frames(), side_by_side(given, lambda: [np.ones((2, 84)), *shone[1:]], "fast"), strict=True
    ):
        wanted, found = known.frame.image.astype(int), again.frame.image.astype(int)
        assert np.abs(wanted - found).mean() < 0.1
        assert np.quantile(np.abs(wanted - found), 0.999) <= 2
        assert bright.frame.image.mean() > found.mean() > dark.frame.image.mean()
        assert [vehicle.vehicle_id for vehicle in dark.vehicles] == [vehicle.vehicle_id for vehicle in known.vehicles]


def test_cars_side_by_side_see_what_each_would_see_alone() -> None:
    levels = np.full((2, 84), 0.3)
    alone = side_by_side(lit(), lambda: [levels], "fast", profile=OWN)
    both = side_by_side(lit(), lambda: [np.ones((2, 84)), levels], "fast", profile=OWN)
    for (expected,), (_, found) in zip(alone, both, strict=True):
        assert np.array_equal(expected.frame.image, found.frame.image)
