"""`tare` and `calibrate` through simulated instruments over ptys, to a recording that carries them."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from functools import partial

import numpy as np
import pytest
import sawbench.acquisition.calibration_book
import sawbench.acquisition.device_probe
import sawbench.acquisition.recorder
import sawbench.commands.recording_session
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.calibration_book import read_book
from sawbench.acquisition.calibration_fit import CalibrationPoint, read_points, write_points
from sawbench.bench.errors import InputError
from sawbench.commands.main import main
from sawbench.storage.reader import read_recording

from tests.rigs import resting as rest_bench

pytestmark = [pytest.mark.pipeline, pytest.mark.skipif(os.name != "posix", reason="this system has no pty")]
TRUE_ZERO_N, TRUE_GAIN = 12.0, 1.02
BUILD, PROBE, RECORD = (
    sawbench.acquisition.calibration_book.build_calibrated,
    sawbench.acquisition.device_probe.probe_devices,
    sawbench.acquisition.recorder.record,
)


class Bench:
    """Stands in for the process of `simulated_bench`: the rig's ports and, for host and rig, the rig's time."""

    def __init__(self, monkeypatch, folder):
        self.config_path = folder / "bench_config.toml"
        shutil.copy(rest_bench.CONFIG, self.config_path)
        self.book_path = folder / "bench_config.calibration-simulated.toml"
        # What the sensor says: its own zero and gain, which nobody is told.
        self.force = lambda load, t, noise: TRUE_ZERO_N + TRUE_GAIN * load + 0.3 * noise
        self._clock = lambda: 0.0
        monkeypatch.setattr(sawbench.commands.recording_session, "simulated_bench", self._bench)
        monkeypatch.setattr(sawbench.acquisition.calibration_book, "build_calibrated", partial(BUILD, clock=self.now))
        monkeypatch.setattr(sawbench.acquisition.device_probe, "probe_devices", partial(PROBE, clock=self.now))
        monkeypatch.setattr(sawbench.acquisition.recorder, "record", partial(RECORD, clock=self.now))

    def now(self):
        """Time of the rig that runs at the moment."""
        return self._clock()

    @contextlib.contextmanager
    def _bench(self, config_path, *, load=None, **_):
        channel, applied = load or ("force_n", 0.0)
        assert config_path == self.config_path and channel == "force_n"
        with rest_bench.resting_bench({"force_n": partial(self.force, applied)}) as rig:
            self._clock = rig.clock
            yield rig.ports

    def run(self, name, *arguments):
        return main([name, "--config", str(self.config_path), "--simulated", *map(str, arguments)])

    def entries(self):
        return read_book(self.book_path).entries


@pytest.fixture
def bench(monkeypatch, tmp_path):
    return Bench(monkeypatch, tmp_path)


def test_a_tare_is_right_is_kept_and_reaches_the_recording(bench, tmp_path, capsys):
    assert bench.run("tare", "--seconds", 1, "--operator", "Kim", "--note", "blade mounted", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert abs(said["details"]["offset"] - TRUE_ZERO_N) < 4 * said["details"]["offset_std"]
    assert 0.001 < said["details"]["offset_std"] < 0.05
    (entry,) = bench.entries()
    assert (entry.kind, entry.device, entry.operator, entry.note) == ("tare", "load_cell", "Kim", "blade mounted")
    assert entry.instrument["model"] == "GSV-8" and entry.software.startswith("sawbench")
    assert entry.result.zero_raw == pytest.approx(TRUE_ZERO_N / 250.0, abs=4 * entry.zero_std_raw)

    assert bench.run("record", "--material", "none", "--seconds", 0.8, "--out", tmp_path / "out") == 0
    recording = read_recording(tmp_path / "out" / "none-01.mcap")
    force = recording.signals["force_n"]
    assert abs(force.values.mean()) < 0.05
    # Which tare it was, and the raw values, are in the file.
    (kept,) = json.loads(recording.provenance["calibration book force_n"])
    assert kept["note"] == "blade mounted"
    used = Calibration.model_validate_json(recording.provenance["calibration values force_n"])
    np.testing.assert_array_equal(used.apply(force.raw), force.values)
    assert np.mean(250.0 * force.raw) == pytest.approx(TRUE_ZERO_N, abs=0.05)
    assert "tare of" in recording.provenance["calibration force_n"]


def test_a_device_with_another_name_and_a_configuration_without_a_book_are_said(bench, tmp_path, capsys):
    record = ("record", "--material", "none", "--seconds", 0.8, "--out", tmp_path / "out")
    assert bench.run(*record) == 0
    assert f"no calibration book was found at {bench.book_path.resolve()}" in capsys.readouterr().err
    assert bench.run("tare", "--seconds", 1) == 0
    assert bench.run(*record) == 0
    said = capsys.readouterr().err
    assert "force_n: tare of" in said and "no calibration book" not in said
    bench.config_path.write_text(bench.config_path.read_text().replace("devices.load_cell", "devices.sensor"))
    # The book of the real bench; the refusal comes before a port is opened.
    shutil.copy(bench.book_path, bench.config_path.with_name("bench_config.calibration.toml"))
    for name, *options in (record, ("check", "--seconds", 0.6)):
        assert main([name, "--config", str(bench.config_path), *map(str, options)]) == 2
        said = capsys.readouterr().err
        assert "'load_cell', which is not configured; force_n is given by 'sensor'" in said
        assert "force_n: tare of" not in said


def test_a_tare_of_another_amplifier_is_said(bench, tmp_path, capsys):
    """Its serial number is in the book; the one that is there says another."""
    assert bench.run("tare", "--seconds", 1) == 0
    number = bench.entries()[0].instrument["serial_number"]
    record = ("record", "--material", "none", "--seconds", 0.8, "--out", tmp_path / "out")
    assert bench.run(*record) == 0
    assert bench.run("check", "--seconds", 0.6, "--json") == 0
    said = capsys.readouterr()
    assert "serial number" not in said.err and "calibration_of_other_instrument" not in said.out

    bench.book_path.write_text(bench.book_path.read_text().replace(number, "999999"))
    words = f"was made with serial number 999999, the instrument now has {number}"
    assert bench.run(*record) == 0
    assert words in capsys.readouterr().err
    events = read_recording(tmp_path / "out" / "none-02.mcap").events
    assert [e.device for e in events if words in e.text] == ["load_cell"]
    assert bench.run("check", "--seconds", 0.6, "--json") == 0
    findings = json.loads(capsys.readouterr().out)["findings"]
    (found,) = [f for f in findings if f["code"] == "calibration_of_other_instrument"]
    assert words in found["what"] and (found["device"], found["channel"]) == ("load_cell", "force_n")


def test_a_second_tare_is_added_and_holds(bench):
    assert bench.run("tare", "--seconds", 1) == 0
    bench.force = lambda load, t, noise: 5.0 + load + 0.3 * noise
    assert bench.run("tare", "--seconds", 1) == 0
    first, second = bench.entries()
    assert first.result.zero_raw == pytest.approx(TRUE_ZERO_N / 250.0, abs=1e-3)
    assert second.result.zero_raw == pytest.approx(5.0 / 250.0, abs=1e-3)


def test_after_a_change_of_the_configuration_record_refuses_until_tared_anew(bench, tmp_path, capsys):
    assert bench.run("tare", "--seconds", 1) == 0
    text = bench.config_path.read_text()
    bench.config_path.write_text(text.replace("scale = 250.0", "scale = 240.0"))
    assert bench.run("record", "--material", "none", "--seconds", 0.8, "--out", tmp_path / "out") == 2
    assert "`sawbench tare`" in capsys.readouterr().err
    assert bench.run("tare", "--seconds", 1) == 0
    assert bench.run("record", "--material", "none", "--seconds", 0.8, "--out", tmp_path / "out") == 0


@pytest.mark.parametrize(
    ("force", "said"),
    [
        (lambda load, t, noise: 3.0 * t + 0.3 * noise, "drifts by +"),
        (lambda load, t, noise: 4.0 * np.cos(2 * np.pi * t / 0.5) + 0.3 * noise, "moves by"),
        (lambda load, t, noise: np.full(len(t), 1.0), "exactly"),
        (lambda load, t, noise: 300.0 + 0.3 * noise, "a load, not a zero"),
    ],
)
def test_a_tare_is_refused_with_the_reason(bench, capsys, force, said):
    bench.force = force
    assert bench.run("tare", "--seconds", 1) == 1
    assert said in capsys.readouterr().err
    assert not bench.book_path.exists()


def test_a_calibration_finds_gain_and_zero_and_is_never_lost(bench, capsys):
    loads = (0, 100, 300, 200, 0)
    asked = [word for load in loads for word in ("--point", load)]
    assert bench.run("calibrate", "--seconds", 0.6, *asked, "--operator", "Kim", "--json") == 0
    fit = json.loads(capsys.readouterr().out)["fit"]
    # The sensor says 12 + 1.02 F in newtons of the nominal 250 N per mV/V.
    assert abs(fit["gain"] - 250.0 / TRUE_GAIN) < 4 * fit["gain_std"]
    assert abs(fit["zero_raw"] - TRUE_ZERO_N / 250.0) < 4 * fit["zero_std_raw"]
    assert fit["gain_std"] < 1e-3 * fit["gain"]
    assert fit["nonlinearity"] < 0.001

    assert bench.run("calibrate", "--seconds", 0.6, *asked) == 2
    assert "--force" in capsys.readouterr().err
    assert len(bench.entries()) == 1
    bench.force = lambda load, t, noise: -load + 0.3 * noise
    assert bench.run("calibrate", "--seconds", 0.6, "--force", "--point", 0, "--point", 50, "--point", 100) == 1
    first, second = bench.entries()
    assert first.result.scale == pytest.approx(fit["gain"]) and first.operator == "Kim"
    assert second.result.scale == pytest.approx(-250.0, rel=0.01)


def test_a_wrong_sign_is_not_kept(bench, capsys):
    bench.force = lambda load, t, noise: -load + 0.3 * noise
    assert bench.run("calibrate", "--seconds", 0.6, "--point", 0, "--point", 50, "--point", 100) == 1
    assert "sign has changed" in capsys.readouterr().err
    assert not bench.book_path.exists()


def test_points_from_a_table_and_masses(bench, tmp_path, capsys):
    path = tmp_path / "points.csv"
    rows = [f"{m},{0.02 + m * 9.80665 / 245.0:.9f},1e-5" for m in (0, 10, 20, 10.5, 0)]
    path.write_text("\n".join(["reference,raw,raw_std", *rows]) + "\n")
    assert bench.run("calibrate", "--from", path, "--kilograms") == 0
    assert "hysteresis" in capsys.readouterr().out
    (entry,) = bench.entries()
    assert entry.result.scale == pytest.approx(245.0, rel=1e-5)
    assert entry.result.zero_raw == pytest.approx(0.02, abs=1e-6)
    assert len(entry.details["points"]) == 5
    # Newtons that are kilograms, and what makes no sense.
    assert bench.run("calibrate", "--from", path, "--force", "--channel", "displacement_mm") == 1
    assert bench.run("calibrate", "--from", tmp_path / "none.csv", "--force") == 2
    assert bench.run("tare", "--channel", "torque_n_m") == 2


def test_the_uncertainty_of_the_known_values_holds_for_a_table_that_states_none(bench, tmp_path, capsys):
    """As if the table had a column of it; 20 N on four loads 100 N apart make u(gain)/gain = 20/(100 sqrt 5)."""
    loads, raw = (0, 100, 200, 300), (0.0, 0.4, 0.8, 1.2)

    def fit(name, last, *options):
        path = tmp_path / name
        rows = [f"{f},{r},{std}" for f, r, std in zip(loads, raw, last, strict=True)]
        path.write_text("\n".join(["reference,raw,reference_std", *rows]) + "\n")
        code = bench.run("calibrate", "--from", path, "--reference-rel-std", 0, "--force", "--json", *options)
        said = capsys.readouterr()
        return (code, said.err) if code else json.loads(said.out)["fit"]["gain_rel_std"]

    by_option = fit("bare.csv", ("", "", "", 20), "--reference-std", 20)
    assert by_option == pytest.approx(20.0 / (100.0 * 5.0**0.5), rel=1e-9)
    assert by_option == fit("column.csv", (20, 20, 20, 20))
    code, said = fit("other.csv", (20, 20, 20, 10), "--reference-std", 20)
    assert code == 2 and "the column reference_std states 10, --reference-std 20" in said


def answering(monkeypatch, react):
    """Stand in for the operator: `react` is told what is asked and says the answer."""
    asked = []

    def prompt(text, **_):
        asked.append(text)
        return react(text)

    monkeypatch.setattr("click.prompt", prompt)
    return asked


@contextlib.contextmanager
def real_ports(bench):
    """The rig as if its ports were those of the configuration."""
    with bench._bench(bench.config_path) as ports:
        text = bench.config_path.read_text()
        for name, port in zip(("/dev/ttyACM0", "/dev/ttyACM1", "/dev/ttyACM2"), ports.values(), strict=True):
            text = text.replace(name, port)
        bench.config_path.write_text(text)
        yield


def test_the_interactive_way_asks_for_each_load(bench, monkeypatch, capsys):
    """Without --simulated and --point: values are typed, here against a rig whose load follows the typing."""
    typed, hanging = ["0", "100", "two", "200,0", ""], [0.0]
    bench.force = lambda load, t, noise: TRUE_ZERO_N + hanging[0] + 0.3 * noise

    def answer(*_, **__):
        text = typed.pop(0)
        with contextlib.suppress(ValueError):
            hanging[0] = float(text.replace(",", "."))
        return text

    asked = answering(monkeypatch, answer)
    with real_ports(bench):
        assert main(["calibrate", "--config", str(bench.config_path), "--seconds", "0.6"]) == 0
    (entry,) = read_book(bench.config_path.with_name("bench_config.calibration.toml")).entries
    assert entry.result.scale == pytest.approx(250.0, rel=1e-3)
    assert entry.result.zero_raw == pytest.approx(TRUE_ZERO_N / 250.0, abs=1e-3)
    assert set(asked) == {"cutting force: apply a known load, let it settle, and type it in N; empty to end"}
    assert "\n100 N: " in capsys.readouterr().err
    # The book of the simulated bench is another one.
    assert not bench.book_path.exists()


def test_a_load_that_swings_is_read_again_and_no_point_is_lost(bench, monkeypatch):
    hanging = {"load": 0.0, "swing": 0.0}
    bench.force = lambda load, t, noise: (
        TRUE_ZERO_N + hanging["load"] + hanging["swing"] * np.cos(2 * np.pi * t / 0.5) + 0.3 * noise
    )

    def operator(text):
        hanging["swing"] = 0.0
        if text.startswith("apply"):
            hanging["load"] = float(text.split()[1])
            hanging["swing"] = 4.0 if hanging["load"] == 100.0 else 0.0
        return ""

    asked = answering(monkeypatch, operator)
    points = [word for load in (0, 100, 200) for word in ("--point", str(load))]
    with real_ports(bench):
        assert main(["calibrate", "--config", str(bench.config_path), "--seconds", "0.6", *points]) == 0
    assert [text.split()[0] for text in asked] == ["apply", "apply", "let", "apply"]
    (entry,) = read_book(bench.config_path.with_name("bench_config.calibration.toml")).entries
    assert entry.result.scale == pytest.approx(250.0, rel=1e-3)
    assert [p["reference"] for p in entry.details["points"]] == [0.0, 100.0, 200.0]


def test_points_taken_before_the_operator_ends_are_kept_and_gone_on_with(bench, monkeypatch, capsys):
    hanging = [0.0]
    bench.force = lambda load, t, noise: TRUE_ZERO_N + hanging[0] + 0.3 * noise

    def operator(text):
        hanging[0] = 9.80665 * float(text.split()[1])
        if hanging[0] > 200.0 and not list(bench.config_path.parent.glob("calibration-points-*")):
            raise KeyboardInterrupt
        return ""

    asked = answering(monkeypatch, operator)
    command = ["calibrate", "--config", str(bench.config_path), "--seconds", "0.6", "--kilograms"]
    with real_ports(bench):
        assert main([*command, "--point", "0", "--point", "12", "--point", "25"]) != 0
        (kept,) = bench.config_path.parent.glob("calibration-points-force_n-*.csv")
        assert f"--kilograms --from {kept}" in capsys.readouterr().err
        assert [p.reference for p in read_points(kept)] == [0.0, 12.0]
        assert main([*command, "--from", str(kept), "--point", "25"]) == 0
    assert len(asked) == 4 and "apply 25 kg" in asked[-1]
    (entry,) = read_book(bench.config_path.with_name("bench_config.calibration.toml")).entries
    assert entry.result.scale == pytest.approx(250.0, rel=1e-3)
    assert [p["reference"] for p in entry.details["points"]] == pytest.approx([0.0, 117.6798, 245.16625])


@pytest.mark.parametrize(("loads", "words"), [("0 10", "are too few"), ("0 10 10 20", "twice in a row")])
def test_loads_that_tell_no_line_are_refused_before_one_hangs(bench, monkeypatch, capsys, loads, words):
    asked = answering(monkeypatch, lambda _: "")
    points = [word for load in loads.split() for word in ("--point", load)]
    with real_ports(bench):
        assert main(["calibrate", "--config", str(bench.config_path), "--seconds", "0.6", *points]) == 2
    assert words in capsys.readouterr().err
    assert not asked


def test_loads_that_were_typed_and_are_too_few_are_kept(bench, monkeypatch, capsys):
    typed = ["0", "100", ""]
    bench.force = lambda load, t, noise: TRUE_ZERO_N + 0.3 * noise
    answering(monkeypatch, lambda *_: typed.pop(0))
    with real_ports(bench):
        assert main(["calibrate", "--config", str(bench.config_path), "--seconds", "0.6"]) == 2
    (kept,) = bench.config_path.parent.glob("calibration-points-force_n-*.csv")
    assert [p.reference for p in read_points(kept)] == [0.0, 100.0]
    assert "are too few" in capsys.readouterr().err


def kept_points(bench):
    (kept,) = bench.config_path.parent.glob("calibration-points-force_n-*.csv")
    return kept, [p.reference for p in read_points(kept)]


def test_points_of_a_calibration_that_is_not_stored_are_kept(bench, capsys):
    """A sensor that saturates is refused; the loads need not be hung again to store it all the same."""
    bench.force = lambda load, t, noise: TRUE_ZERO_N + min(load, 150.0) + 0.3 * noise
    points = [word for load in (0, 100, 200) for word in ("--point", load)]
    assert bench.run("calibrate", "--seconds", 0.6, *points) == 1
    kept, loads = kept_points(bench)
    said = capsys.readouterr().err
    assert "deviate from a straight line" in said and f"--simulated --from {kept}" in said
    assert loads == [0.0, 100.0, 200.0] and not bench.book_path.exists()
    assert bench.run("calibrate", "--from", kept, "--force") == 1
    assert [p["reference"] for p in bench.entries()[0].details["points"]] == loads
    assert len(list(kept.parent.glob("calibration-points-*"))) == 1


def test_points_are_kept_where_the_book_cannot_be_written(bench, monkeypatch):
    def full(path, _):
        raise InputError("cannot be written: no space left", where=path)

    monkeypatch.setattr(sawbench.acquisition.calibration_book, "add_entry", full)
    assert bench.run("calibrate", "--seconds", 0.6, "--point", 0, "--point", 100, "--point", 200) != 0
    assert kept_points(bench)[1] == [0.0, 100.0, 200.0]


def test_loads_that_are_no_numbers_are_refused_where_they_are_typed(bench, monkeypatch, capsys):
    """On the command line before a load hangs; at the question it is asked again."""
    answering(monkeypatch, lambda _: pytest.fail("a load was asked for"))
    points = [word for load in ("0", "nan", "100", "200") for word in ("--point", load)]
    assert main(["calibrate", "--config", str(bench.config_path), *points]) == 2
    assert "the load nan is not a finite number" in capsys.readouterr().err
    typed, hanging = ["0", "nan", "100", "inf", "200", ""], [0.0]
    bench.force = lambda load, t, noise: TRUE_ZERO_N + hanging[0] + 0.3 * noise

    def answer(_):
        text = typed.pop(0)
        hanging[0] = float(text) if text.isdigit() else hanging[0]
        return text

    answering(monkeypatch, answer)
    with real_ports(bench):
        assert main(["calibrate", "--config", str(bench.config_path), "--seconds", "0.6"]) == 0
    said = capsys.readouterr().err
    assert "'nan' is not a number" in said and "'inf' is not a number" in said
    (entry,) = read_book(bench.config_path.with_name("bench_config.calibration.toml")).entries
    assert [p["reference"] for p in entry.details["points"]] == [0.0, 100.0, 200.0]


@pytest.mark.parametrize("raw", [(0.0, 0.9, -0.8, 0.1), (0.1, 0.5, 0.5, 0.1)])
def test_a_gain_of_unknown_sign_is_never_stored(bench, tmp_path, capsys, raw):
    path = tmp_path / "points.csv"
    path.write_text("reference,raw\n" + "".join(f"{100 * k},{r}\n" for k, r in enumerate(raw)))
    assert bench.run("calibrate", "--from", path, "--force") in {1, 2}
    said = capsys.readouterr().err
    assert "not even its sign" in said or "do not follow the loads" in said
    assert "internal error" not in said and not bench.book_path.exists()


def test_a_former_polynomial_that_is_flat_at_its_zero_is_no_obstacle(bench, tmp_path, capsys):
    text = bench.config_path.read_text()
    bench.config_path.write_text(text.replace("scale = 250.0", "polynomial = [0.0, 0.0, 3.0]", 1))
    path = tmp_path / "points.csv"
    path.write_text("reference,raw\n0,0.1\n100,0.5\n200,0.9\n100,0.5\n")
    assert bench.run("calibrate", "--from", path) == 0
    assert "relative to the previous one" not in capsys.readouterr().out
    assert bench.entries()[0].result.scale == pytest.approx(250.0)


def test_a_table_of_points_is_read_back_as_it_was_written(tmp_path):
    points = [
        CalibrationPoint(reference=0.1 * k, raw=np.pi / (k + 1), raw_std=1e-5 / 3, reference_std=k) for k in range(4)
    ]
    write_points(tmp_path / "points.csv", points)
    assert list(read_points(tmp_path / "points.csv")) == points
