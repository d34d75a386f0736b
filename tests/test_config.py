"""Configuration: what is written reads back equal, and what is wrong is named."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.config import (
    PRESETS,
    ClassifierConfig,
    GuardConfig,
    PipelineConfig,
    ProposalConfig,
    TrackerConfig,
    config_to_toml,
    preset,
    read_config,
)

corners = st.lists(st.integers(0, 9000), min_size=2, max_size=2, unique=True).map(sorted)
regions = st.tuples(corners, corners).map(lambda c: (c[0][0], c[1][0], c[0][1], c[1][1]))
proposal_configs = st.builds(
    ProposalConfig,
    kappa=st.floats(0, 10),
    window_px=st.integers(2, 512),
    eps=st.floats(0, 1, exclude_min=True),
    min_deviation=st.floats(0, 1),
    gap_px=st.integers(1, 64),
    min_area_px=st.floats(0, 100),
    max_area_px=st.floats(100, 1e9) | st.just(float("inf")),
    normalise=st.booleans(),
    window=st.sampled_from(["published", "centred"]),
    region_xyxy_px=st.none() | regions,
    backend=st.sampled_from(["native", "reference"]),
)
paths = st.text("abc/.\\\"' é\n", min_size=1).map(Path)
classifier_configs = st.builds(ClassifierConfig, model=st.none() | paths, score_threshold=st.floats(0, 1))
tracker_configs = st.builds(
    TrackerConfig,
    method=st.sampled_from(["alpha_beta", "published", "none"]),
    clock=st.sampled_from(["frames", "time"]),
    range_gate=st.just(float("inf")) | st.floats(0.1, 9),
    compensate_yaw=st.booleans(),
)
guard_configs = st.builds(
    GuardConfig,
    white_level=st.none() | st.integers(1, 65535),
    led_limits_cd=st.lists(st.floats(1, 9e3), min_size=1, max_size=5).map(
        lambda limits: tuple((50.0 * index, limit) for index, limit in enumerate(sorted(limits)))
    ),
)
configs = st.builds(
    PipelineConfig,
    proposals=proposal_configs,
    classifier=classifier_configs,
    tracker=tracker_configs,
    guard=guard_configs,
)


def read_text(text: str, base: PipelineConfig | None = None) -> PipelineConfig:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "config.toml")
        path.write_text(text, encoding="utf-8")
        return read_config(path, base)


@pytest.mark.slow
@given(configs)
def test_what_is_written_reads_back_equal(config: PipelineConfig) -> None:
    assert read_text(config_to_toml(config)) == config


@pytest.mark.parametrize("base", sorted(PRESETS))
@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_whole_configuration_is_the_same_on_any_preset(name: str, base: str) -> None:
    """`--config RUN/config.toml` starts from the preset `foreglow`, whose model a run without one must not get."""
    assert read_text(config_to_toml(PRESETS[name]), PRESETS[base]) == PRESETS[name]


def test_a_field_may_be_without_the_value_of_its_base() -> None:
    base = preset("foreglow").changed("beam", headlamps=Path("lamps.toml"))
    config = read_text('[classifier]\nmodel = "none"\n[beam]\nheadlamps = "none"\npolicy = "none"', base)
    assert (config.classifier.model, config.beam.headlamps, config.beam.policy) == (None, None, "none")
    with pytest.raises(ValueError, match=r"proposals.gap_px: .*got 'none'"):
        read_text('[proposals]\ngap_px = "none"')


def test_infinity_and_region_read_back() -> None:
    proposals = ProposalConfig(max_area_px=float("inf"), region_xyxy_px=(1, 2, 30, 40))
    config = PipelineConfig(proposals=proposals)
    text = config_to_toml(config)
    assert "max_area_px = inf" in text
    assert read_text(text) == config


def test_file_overrides_only_the_fields_it_names() -> None:
    config = read_text("[proposals]\ngap_px = 7\n[classifier]\nsupport = 3", preset("baseline"))
    expected = preset("baseline").proposals.model_copy(update={"gap_px": 7})
    assert config.proposals == expected
    assert config.classifier == ClassifierConfig(support=3)


def test_empty_file_is_the_base() -> None:
    assert read_text("") == PRESETS["paper"]
    assert read_text("[proposals]", PRESETS["baseline"]) == PRESETS["baseline"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "[tracker]\nrate_hz = 1e-9",
            "config.toml: tracker.rate_hz: Input should be greater than or equal to 0.1, got 1e-09",
        ),
        ("[proposals]\nkappa = 11", "config.toml: proposals.kappa: Input should be less than or equal to 10, got 11"),
        ("[proposals]\nkappa = nan", "proposals.kappa: .*got nan"),
        ("[proposals]\nmax_area_px = nan", "proposals.max_area_px: .*got nan"),
        ("[proposals]\nkappa = inf", "proposals.kappa: .*got inf"),
        ("[proposals]\nkappa = true", "proposals.kappa: Input should be a valid number, got True"),
        ("[proposals]\ngap_px = '4'", "proposals.gap_px: Input should be a valid integer, got '4'"),
        ("[proposals]\nblur_width_px = true", "proposals.blur_width_px: Input should be a valid integer, got True"),
        ("[proposals]\nblur_height_px = 1.0", "proposals.blur_height_px: Input should be a valid integer, got 1.0"),
        ("[proposals]\nblur_height_px = 5", "proposals.blur_height_px: Input should be 1 or 3, got 5"),
        ("[proposals]\nnormalise = 1", "proposals.normalise: Input should be a valid boolean, got 1"),
        ("[proposals]\nregion_xyxy_px = [0, 0, true, 9]", "proposals.region_xyxy_px.2: .*got True"),
        ("[proposals]\nregion_xyxy_px = [0, 0, 3000000000, 9]", "region_xyxy_px.2: .*2147483647, got 3000000000"),
        ("[proposals]\nmax_area_px = 3", "proposals.min_area_px: expected at most max_area_px, 3, got 11"),
        ("[proposals]\nwindow_px = 1.5", "proposals.window_px: .*got 1.5"),
        ("[proposals]\nblur_width_px = 2", "proposals.blur_width_px: Input should be 1, 3 or 5, got 2"),
        ("[proposals]\nregion_xyxy_px = [5, 0, 5, 9]", r"region_xyxy_px: expected 0 <= x1 < x2 .*\(5, 0, 5, 9\)"),
        ("[proposals]\nregion_xyxy_px = [1, 2, 3]", r"proposals.region_xyxy_px.3: .*got \[1, 2, 3\]"),
        ("[proposals]\nbackend = 'gpu'", "proposals.backend: .*'native' or 'reference', got 'gpu'"),
        ("[proposals]\nkapa = 1", "proposals.kapa: unknown, expected one of kappa, window_px, "),
        ("[tracker]\nmin_iou = 1.0", "tracker.min_iou: Input should be less than 1, got 1.0"),
        ("[tracker]\nmethod = 3", "tracker.method: Input should be a valid string, got 3"),
        ("[tracker]\nconfirmation = 'm_of_n'\nnum_looks = 4", "min_hits: expected at most num_looks, 4, got 5"),
        ("[tracker]\nreject_evidence = 3.5", "reject_evidence: expected at most confirm_evidence, 1.5, got 3.5"),
        ("[tracker]\nrange_gate = nan", "tracker.range_gate: .*got nan"),
        ("[lamps]\na = 1", "lamps: unknown, expected one of proposals, classifier, distance, tracker"),
        ("proposals = 3", "proposals: .*got 3"),
        ("kappa =", "expected TOML: Invalid value"),
        ("[classifier]\nmodel = 3", "classifier.model: .*got 3"),
        ("[standing]\nlearn_s = 0", "standing.learn_s: Input should be greater than 0, got 0"),
        ("[standing]\nmax_area = 0.5", "standing.max_area: Input should be less than or equal to 0.1, got 0.5"),
    ],
)
def test_wrong_file_is_named_with_field_and_value(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint) as caught:
        read_text(text)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=80) | st.text(max_size=80).map(lambda text: ("[proposals]\n" + text).encode()))
def test_any_file_is_read_or_refused_in_one_line(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "config.toml")
        path.write_bytes(data)
        try:
            assert isinstance(read_config(path), PipelineConfig)
        except ValueError as error:
            assert str(error).startswith(str(path))  # noqa: PT017


def test_binary_file_is_no_toml(tmp_path: Path) -> None:
    for content, expected in ((b"\x80\xfe\x00", "expected TOML"), (b"\xff\xfe\x00", "UTF-8 text, is UTF-16")):
        (tmp_path / "config.toml").write_bytes(content)
        with pytest.raises(ValueError, match=expected):
            read_config(tmp_path / "config.toml")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"absent\.toml: no such file"):
        read_config(tmp_path / "absent.toml")


def test_unknown_preset_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match="expected one of paper, baseline, foreglow, got 'best'"):
        preset("best")


def test_published_parameter_sets() -> None:
    paper, baseline = preset("paper").proposals, preset("baseline").proposals
    assert (paper.kappa, paper.window_px, paper.min_deviation, paper.gap_px) == (0.4, 19, 0.01, 4)
    assert (baseline.kappa, baseline.window_px, baseline.min_deviation, baseline.gap_px) == (0.5, 20, 0.005, 13)


def test_the_detector_alone() -> None:
    config = preset("foreglow")
    alone = config.detector_only
    assert (alone.distance.estimator, alone.tracker.method) == ("none", "none")
    assert (alone.proposals, alone.classifier) == (config.proposals, config.classifier)
    assert config.tracker.method != "none"


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("low_below_mps = 50.0", "low_below_mps: expected at most high_above_mps, 9.72222, got 50"),
        ("brightening_s = 1e-9", "brightening_s: Input should be greater than or equal to 0.1"),
        ("led_limits_cd = []", "led_limits_cd: List should have at least 1 item"),
        ("led_limits_cd = [[1.0, 100.0]]", "led_limits_cd: expected ranges that grow from 0 on"),
        ("led_limits_cd = [[0.0, 100.0], [0.0, 200.0]]", "led_limits_cd: expected ranges that grow from 0 on"),
        ("led_limits_cd = [[0.0, 100.0], [50.0, 90.0]]", "led_limits_cd: expected ranges that grow from 0 on"),
        ("led_limits_cd = [[0.0, 0.0]]", "led_limits_cd.0.1: Input should be greater than 0"),
        ("led_limits_cd = [[0.0]]", "led_limits_cd.0"),
    ],
)
def test_guard_that_makes_no_sense(line: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        read_text(f"[guard]\n{line}")


@pytest.mark.parametrize(
    ("section", "field"),
    [
        (section, name)
        for section, model in PipelineConfig()
        for name, value in model
        if isinstance(value, float | tuple) or (isinstance(value, int) and not isinstance(value, bool))
    ],
)
def test_every_number_has_a_range(section: str, field: str) -> None:
    is_table = isinstance(getattr(getattr(PipelineConfig(), section), field), tuple)
    for number in ("1e300", "-1e300", "nan", "9000000000000000000"):
        text = f"[[0.0, 1.0], [50.0, {number}]]" if is_table else number
        with pytest.raises(ValueError, match=rf"config\.toml: {section}\.{field}\b") as caught:
            read_text(f"[{section}]\n{field} = {text}")
        assert "\n" not in str(caught.value)


def test_lowest_elevation_above_the_highest() -> None:
    with pytest.raises(
        ValueError, match=r"lit_street\.min_elevation_deg: expected at most max_elevation_deg, 20, got 21"
    ):
        read_text("[lit_street]\nmin_elevation_deg = 21.0")


def test_limits_of_the_guard() -> None:
    guard = read_text("[guard]\nled_limits_cd = [[0, 100], [60, 100.0]]").guard
    assert guard.led_limits_cd == ((0.0, 100.0), (60.0, 100.0))
    assert GuardConfig(low_below_mps=9.0, high_above_mps=9.0).low_below_mps == 9.0


def test_a_model_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "model.onnx").touch()
    monkeypatch.chdir(tmp_path)
    Path("config.toml").write_text(
        config_to_toml(PipelineConfig(classifier=ClassifierConfig(model=Path("model.onnx"))))
    )
    assert read_config("config.toml").classifier.model == tmp_path / "model.onnx"
    Path("foreglow").touch()  # such as the command itself, beside which a run is made
    assert 'model = "foreglow"' in config_to_toml(preset("foreglow")), "the name of one that ships"


def test_a_byte_order_mark_is_no_content() -> None:
    """Some editors put it first."""
    assert read_text("\ufeff[proposals]\ngap_px = 7") == read_text("[proposals]\ngap_px = 7")


@pytest.mark.parametrize(
    ("section", "fields"),
    [
        ("guard", {"max_gap_s": math.nan}),
        ("guard", {"max_same_images": math.nan}),
        ("guard", {"low_below_mps": -1.0}),
        ("guard", {"max_gap": 0.1}),
        ("guard", {"low_below_mps": 30.0}),  # above high_above_mps
        ("tracker", {"rate_hz": "18"}),
        ("classifier", {"score_threshold": math.inf}),
    ],
)
def test_what_is_changed_in_python_is_checked_too(section: str, fields: dict[str, Any]) -> None:
    config = preset("foreglow")
    with pytest.raises(ValueError, match=next(iter(fields))):
        getattr(config, section).model_copy(update=fields)
    with pytest.raises(ValueError, match=next(iter(fields))):
        config.changed(section, **fields)


def test_a_section_that_there_is_not() -> None:
    with pytest.raises(ValueError, match="gaurd"):
        preset("foreglow").model_copy(update={"gaurd": GuardConfig()})
    config = preset("foreglow").model_copy(update={"guard": GuardConfig(max_gap_s=0.5)})
    assert config.guard.max_gap_s == 0.5
    assert config.model_copy() == config
