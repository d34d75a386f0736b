"""What ROS 2 reads from the environment is checked before it starts; it needs no ROS 2."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from foreglow.runtime.ros2.environment import (
    ASSERTED,
    MAX_DOMAIN,
    MIDDLEWARE,
    NUM_PARTICIPANTS,
    PARTICIPANT,
    PROFILES,
    prepare,
)
from foreglow.runtime.ros2.supervisor import Process, supervise


@pytest.mark.parametrize("variable", PROFILES)
def test_a_profile_that_fast_dds_would_pass_over_is_refused(variable: str, tmp_path: Path) -> None:
    profile = tmp_path / "mine.xml"
    with pytest.raises(FileNotFoundError, match=f"{variable}: .*mine.xml: no such Fast DDS profile"):
        prepare(environment={variable: str(profile)})
    profile.write_text("<dds>")
    with pytest.raises(ValueError, match=f"{variable}: .*mine.xml: expected a Fast DDS profile in XML"):
        prepare(environment={variable: str(profile)})
    profile.write_text("<dds/>")
    prepare(environment={variable: str(profile)})
    prepare(environment={variable: str(tmp_path / "none.xml"), "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})


def test_our_own_profile_must_be_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foreglow.runtime.ros2.environment.__file__", str(tmp_path / "environment.py"))
    with pytest.raises(FileNotFoundError, match="no such Fast DDS profile"):
        prepare(environment={})


@pytest.mark.parametrize("domain", ["abc", "-1", "1.5", str(MAX_DOMAIN + 1), "9" * 5000])
def test_a_domain_that_is_none(domain: str) -> None:
    with pytest.raises(ValueError, match=f"ROS_DOMAIN_ID: expected a whole number from 0 to {MAX_DOMAIN}"):
        prepare(environment={"ROS_DOMAIN_ID": domain})


@pytest.mark.parametrize("domain", ["", "0", str(MAX_DOMAIN)])
def test_a_domain(domain: str) -> None:
    prepare(environment={"ROS_DOMAIN_ID": domain})


@pytest.mark.parametrize("variable", [MIDDLEWARE, ASSERTED])
@pytest.mark.parametrize("name", ["nonsense", "c", "../x", "rmw_dds_common"])
def test_a_middleware_that_is_not_there(monkeypatch: pytest.MonkeyPatch, variable: str, name: str) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: object())
    monkeypatch.setattr("os.environ", {variable: name})
    with pytest.raises(ValueError, match=f"{variable}: expected a middleware that is installed"):
        prepare()


@pytest.mark.parametrize("number", ["", "abc", "-1", "1.5", str(NUM_PARTICIPANTS), "\N{SUPERSCRIPT TWO}", "9" * 5000])
def test_a_number_that_no_participant_has(number: str) -> None:
    with pytest.raises(ValueError, match=f"{PARTICIPANT}: expected a whole number below {NUM_PARTICIPANTS}"):
        prepare(environment={PARTICIPANT: number})


def test_both_profiles_take_their_number_from_the_environment() -> None:
    for is_networked in (False, True):
        known: dict[str, str] = {}
        prepare(is_networked=is_networked, environment=known)
        assert 0 <= int(known[PARTICIPANT]) < NUM_PARTICIPANTS
        assert f"<participantID>${{{PARTICIPANT}}}</participantID>" in Path(known[PROFILES[0]]).read_text()


def test_a_process_that_is_started_again_has_another_number(monkeypatch: pytest.MonkeyPatch) -> None:
    environments: list[dict[str, str]] = []
    monkeypatch.setattr(subprocess, "Popen", lambda *_, env, **__: environments.append(env))
    process = Process("beam", ["beam"], {"KNOWN": "1"})
    for _ in range(NUM_PARTICIPANTS - 1):
        process.start()
    assert len({environment[PARTICIPANT] for environment in environments}) == NUM_PARTICIPANTS
    assert all(environment["KNOWN"] == "1" for environment in environments)
    for environment in environments:
        prepare(environment=environment)


@pytest.mark.parametrize("code", [0, 2, -9])
def test_what_ended_a_network_with_its_source(monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    class Ended:
        def __init__(self, *_: object, **__: object) -> None:
            self.poll = lambda: code
            self.wait = lambda _: code

    monkeypatch.setattr(subprocess, "Popen", Ended)
    said: list[str] = []
    assert supervise({}, ["source"], lambda: False, said.append, lambda _: None) == (137 if code == -9 else code)
    assert said == (["source was ended by signal 9, and the network with it"] if code == -9 else [])
