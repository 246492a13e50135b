"""Signals while parameters of a vehicle on the ground are changed or restored."""

import os
import signal

import pytest

from alula.cli.shell.options import Common
from alula.cli.verbs.fly.flight import fly
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION
from support.flights.flights import START, mission
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle


class Interrupted(FakeVehicle):
    """Link that gets one signal while parameters are changed, and others while they are restored."""

    number = signal.SIGINT

    def prepare(self):
        os.kill(os.getpid(), self.number)
        raise AssertionError("it went on")

    def close(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(os.getpid(), number)
        super().close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda n: n.name)
def test_parameters_are_put_back_before_it_ends(tmp_path, number):
    link = Interrupted(FakeClock(), (START[0], START[1], 0.0))
    link.number = number
    log = tmp_path / "f.run.mcap"
    common = Common(log, quiet=True, jobs=1)
    with pytest.raises(KeyboardInterrupt):
        fly(mission(), link, Provenance.now(RUN_SCHEMA, RUN_VERSION, {}, None, []), common)
    assert link.closed
    assert not log.exists()


def test_what_could_not_be_put_back_is_told_when_nothing_polls_any_more(tmp_path, capfd):
    class Gone(FakeVehicle):
        def prepare(self):
            raise KeyboardInterrupt

        def close(self):
            self.status.texts.append("GUID_TIMEOUT could not be put back: set it to 3")

    link = Gone(FakeClock(), (START[0], START[1], 0.0))
    common = Common(tmp_path / "f.run.mcap", jobs=1)
    with pytest.raises(KeyboardInterrupt):
        fly(mission(), link, Provenance.now(RUN_SCHEMA, RUN_VERSION, {}, None, []), common)
    assert "vehicle: GUID_TIMEOUT could not be put back: set it to 3" in capfd.readouterr().err
