from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.lab.simulation.camera.profile import (
    PROFILES,
    CameraProfile,
    ImagerSpec,
    ViewSpec,
    profile_to_toml,
    read_profile,
    read_profiles,
)
from foreglow.lab.simulation.camera.view import View
from foreglow.lab.simulation.scenes.scene import SensorSpec
from tests.lab.simulation.cameras import camera


def test_at_least_eight_profiles_ship_two_of_them_pvdn() -> None:
    assert len(PROFILES) >= 8
    assert {"pvdn_day", "pvdn_night"} <= set(PROFILES)


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_that_ships_is_read_back_from_what_is_printed(name: str, tmp_path: Path) -> None:
    profile = read_profile(name)
    assert profile.name == name
    assert profile.about
    path = tmp_path / f"{name}.toml"
    path.write_text(profile_to_toml(profile))
    assert read_profile(str(path)) == profile


def test_a_profile_of_the_scenes_own_sensor_scales_what_the_scene_draws() -> None:
    profile = CameraProfile(name="own", cycle="day", imager=ImagerSpec(model="scene", sensitivity=0.5))
    drawn = SensorSpec(exposure="night", grey_per_cd_m2=60.0)
    assert profile.scene_sensor(drawn) == SensorSpec(exposure="day", grey_per_cd_m2=30.0)


@pytest.mark.parametrize(
    ("text", "field", "expected"),
    [
        ("[imager]\nread_noise_e = -1.0", "imager.read_noise_e", "greater than or equal to 0"),
        ("[tone]\ngamma = 0.0", "tone.gamma", "greater than 0"),
        ("[encoder]\ncodec = 'mjpeg'", "encoder.codec", "'h264' or 'h265'"),
        (
            "[lens]\nveils = [{ share = 0.4 }, { share = 0.5, angle_deg = 1.0 }, { share = 0.3 }]",
            "veils",
            "0.9 together",
        ),
        ("[view]\nwidth_px = 640", "width_px", "together with height_px"),
        ("[exposure]\nmin_gain = 9.0\nmax_gain = 3.0", "min_gain", "up to max_gain 3"),
        ("[lense]\ncore_px = 1.0", "lense", "unknown"),
        ("[lens]\ncore_px = 10000", "lens.core_px", "less than or equal to 20"),  # 75 GB
        ("[imager]\nbloom_px = 1e5", "imager.bloom_px", "less than or equal to 20"),
        ("[tone]\nsharpen_px = 1e5", "tone.sharpen_px", "less than or equal to 20"),
        ("[lens]\nghosts = [{ strength = 0.1, radius_deg = [1e9, 1.0] }]", "radius_deg", "less than or equal to 60"),
        ("[lens]\nghosts = [{ strength = 0.1, shift_deg = [0.0, 1e300] }]", "shift_deg", "less than or equal to 360"),
        ("[encoder]\nkbps = 0.001", "encoder.kbps", "greater than or equal to 1"),  # which no encoder takes
    ],
)
def test_a_bad_profile_is_one_line_with_file_field_and_expectation(
    tmp_path: Path, text: str, field: str, expected: str
) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"own\.toml") as caught:
        read_profile(str(path))
    message = str(caught.value)
    assert field in message
    assert expected in message
    assert "\n" not in message


def test_an_encoder_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import av

    def missing(name: str, _mode: str) -> None:
        raise av.codec.codec.UnknownCodecError(name)

    monkeypatch.setattr(av.codec, "Codec", missing)
    path = tmp_path / "own.toml"
    path.write_text("[encoder]\ncodec = 'h264'")
    with pytest.raises(ValueError, match=r"own\.toml: encoder\.codec.*libx264 is not there"):
        read_profile(str(path))


def test_names_are_known_and_differ() -> None:
    with pytest.raises(ValueError, match=r"--camera: expected one of .*pvdn_day.*got 'pinhole'"):
        read_profile("pinhole")
    with pytest.raises(ValueError, match="'pvdn_day' comes twice"):
        read_profiles("pvdn_day,phone,pvdn_day")


def sized(width_px: int, height_px: int, focal_px: float | None = None) -> CameraProfile:
    return CameraProfile(name="own", view=ViewSpec(width_px=width_px, height_px=height_px, focal_px=focal_px))


def test_a_view_keeps_the_directions_of_its_pixels() -> None:
    rendered = camera(160, 120)
    view = View(sized(60, 32, 0.5 * rendered.focal_px[0]), rendered)
    pixels = np.array([[50.0, 60.0], [91.5, 44.25]])
    np.testing.assert_allclose(view.camera.rays(view.points_px(pixels)), rendered.rays(pixels), atol=1e-9)


@pytest.mark.parametrize(("up", "first_row"), [(1.0, 0), (0.5, 20), (0.0, 40)])
def test_a_view_may_look_up_or_down(up: float, first_row: int) -> None:
    rendered = camera(160, 120)
    profile = CameraProfile(name="own", view=ViewSpec(width_px=160, height_px=80, up=up))
    view = View(profile, rendered)
    image = np.random.default_rng(1).random((120, 160), np.float32)
    np.testing.assert_array_equal(view.light(image), image[first_row : first_row + 80])
    assert view.points_px(np.array([[5.0, 50.0]]))[0].tolist() == [5.0, 50.0 - first_row]


def test_a_view_averages_the_light_of_its_pixels() -> None:
    rendered = camera(160, 120)
    view = View(sized(80, 60), rendered)
    image = np.random.default_rng(1).random((120, 160), np.float32)
    np.testing.assert_allclose(view.light(image), image.reshape(60, 2, 80, 2).mean((1, 3)), rtol=1e-5)


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (sized(200, 120, 164.0), "expected a field of view within the rendering's 160x120 px"),
        (sized(320, 240), r"view\.focal_px: expected up to 164 px, as a rendering of 160x120 px has"),
    ],
)
def test_a_size_that_does_not_fit_the_rendering(profile: CameraProfile, message: str) -> None:
    with pytest.raises(ValueError, match=f"camera own: .*{message}|camera own: {message}"):
        View(profile, camera(160, 120))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[view]\nfocal_px = 500.0\n", r"view\.focal_px: expected together with width_px and height_px, got 500 alone"),
        ("name = 'a/b'\n", "name: expected a plain name without a path, got 'a/b'"),
    ],
)
def test_a_profile_that_cannot_be(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(ValueError, match=rf"own\.toml: {message}$"):
        read_profile(str(tmp_path / "own.toml"))


@pytest.mark.parametrize("field", ["tone.sharpen", "exposure.gain", "lens.core_px", "imager.bloom_px", "encoder.kbps"])
def test_what_a_scenes_own_sensor_does_not_use_is_refused(tmp_path: Path, field: str) -> None:
    """A profile that was printed and edited would make the same images as before."""
    (tmp_path / "own.toml").write_text(f"imager.model = 'scene'\n{field} = 3.0\n")
    with pytest.raises(
        ValueError, match=rf"own\.toml: {field.removesuffix('.kbps')}: expected none with imager\.model"
    ):
        read_profile(str(tmp_path / "own.toml"))
    assert "[tone]" not in profile_to_toml(read_profile("pvdn_night"))


def test_what_only_a_scenes_own_sensor_uses_is_refused(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("[imager]\nlate_gain = 3.0\n")
    with pytest.raises(ValueError, match=r"imager\.late_gain: expected none with imager\.model electrons"):
        read_profile(str(tmp_path / "own.toml"))


def test_a_late_gain_amplifies_black_and_highlights_but_not_the_linear_part() -> None:
    profile = CameraProfile(name="own", imager=ImagerSpec(model="scene", late_gain=2.0, row_noise=1.5, grain_px=1.2))
    before = SensorSpec()
    after = profile.scene_sensor(before)
    assert after.black_level == 2.0 * before.black_level
    assert (after.knee, after.log_slope) == (2.0 * before.knee, 2.0 * before.log_slope)
    assert (after.grey_per_cd_m2, after.read_noise) == (before.grey_per_cd_m2, before.read_noise)
    assert (after.grain_px, after.row_noise) == (1.2, 1.5)
