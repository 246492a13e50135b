"""Decoding of files that others wrote: types in several threads, sizes, depths."""

import json
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.decode import (
    MOST_DEPTH,
    MOST_TOML,
    MOST_VALUES,
    MalformedError,
    convert,
    decode_json,
    decode_toml,
    json_depth,
)
from alula.schemas.scenarios.scenario import Scenario
from support.effort import examples
from support.paths import ROOT

# In each fork, threads that wait for each other decode types for the first time; these share other types.
RACE = """
import os, sys, threading
from alula.schemas.artifacts.kinds import KINDS
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.run import RunRecord
{decode}

kinds = [*(kind.manifest for kind in KINDS.values()), Provenance, RunRecord]
text = b'{{"producer":{{"name":"a","version":"b","commit":"c"}},"inputs":[{{"role":"a","schema":"b",' \\
    b'"version":"c","sha256":"d","name":"e"}}],"arrays":{{"a":{{"dtype":"a"}}}},"guarantee":{{"statement":1}}}}'

def first(number):
    barrier.wait()
    for kind in kinds[number % 3 :]:
        try:
            decode_json(text, kind)
        except ValueError:
            pass

for _ in range({forks}):
    if (child := os.fork()) == 0:
        sys.setswitchinterval(1e-6)
        barrier = threading.Barrier(6)
        threads = [threading.Thread(target=first, args=(number,)) for number in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status:
        sys.exit(f"ended with {{status}}")
"""
GUARDED = "from alula.schemas.decode import decode_json"


@pytest.mark.slow
def test_threads_may_decode_a_type_for_the_first_time_at_once():
    script = RACE.format(decode=GUARDED, forks=examples(100))
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("part", ["schemas", "cli"])
def test_files_are_decoded_in_one_place(part):
    """A decoder that is made elsewhere could describe a type while another thread does."""
    for path in sorted((ROOT / part).rglob("*.py")):
        for call in ("msgspec.json.decode(", "msgspec.json.Decoder(", "msgspec.toml.decode(", "json.loads("):
            made_here = "msgspec.json.encode(" if call == "msgspec.json.decode(" else "\0"
            lines = [line for line in path.read_text().splitlines() if call in line and made_here not in line]
            assert not lines or path.name == "decode.py", f"{path}: {lines}"


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text('ab\\"[]{},:\n'),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text('a\\"[{'), inner, max_size=4),
)


def depth_of(value) -> int:
    if not isinstance(value, list | dict):
        return 0
    return 1 + max(map(depth_of, value.values() if isinstance(value, dict) else value), default=0)


@settings(max_examples=examples(400))
@given(values)
def test_the_depth_of_json_is_that_of_its_values(value):
    assert json_depth(json.dumps(value).encode()) == depth_of(value)
    assert json_depth(json.dumps(value, ensure_ascii=False).encode()) == depth_of(value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"[" * 10**6, "levels"),
        (b"[" * (MOST_DEPTH + 1) + b"]" * (MOST_DEPTH + 1), "levels"),
        (b"[" + b"[]," * MOST_VALUES + b"1]", "values"),
        (b"[1e999]", "out of range"),
        (b"[NaN]", "invalid"),
        (b'["\xff"]', "utf-8"),
        (b"", "truncated"),
    ],
)
def test_json_that_is_too_much_is_refused(text, words):
    with pytest.raises(MalformedError, match=words):
        decode_json(text, list)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (".".join(["a"] * 20_000) + " = 1", "16 parts near line 1"),
        ("b = 1\n" + " . ".join(['"a.b"'] * 20_000) + " = 1", "16 parts near line 2"),
        ("[" + ".".join(["'a'"] * 20_000) + "]", "16 parts"),
        ("a = " + "[" * 100_000 + "]" * 100_000, "levels"),
        ("[a.a.a.a.a.a.a.a]\n" + "b = " + "{ b.b.b.b.b.b.b.b = " * 8 + "1" + "}" * 8, "levels"),
        ("#" * (MOST_TOML + 1), "bytes"),
        ("a = " + "9" * 100_000, "4300 digits"),
        ("a = 0x" + "f" * 100, "64 bits"),
        ("a = 2026-01-01", "date"),
        ('a = { b = """c"""", ' + ".".join("d" * 500) + " = 1 }", "16 parts"),
        ("a = { b = '''c''''', " + ".".join("d" * 500) + " = 1 }", "16 parts"),
    ],
)
def test_toml_that_is_too_much_is_refused(text, words):
    with pytest.raises(MalformedError, match=words):
        decode_toml(text.encode())


def test_strings_and_comments_of_toml_are_no_keys():
    dots = ".".join(["a"] * 40)
    text = f'# {dots}\na = "{dots}"\nb = \'{dots}\'\nc = \'\'\'\n{dots}\'\'\'\nd = """{dots}\\"""""\n'
    assert decode_toml(text.encode()) == {"a": dots, "b": dots, "c": dots, "d": dots + '""'}


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        ({"vehicle": {"radius": 0.1}}, "did you mean `radius_m`?"),
        ({"world": {"moving": [{"radius": 0.1}]}}, "did you mean `radius_m`?"),
        ({"rules": {"trails": 5}}, "did you mean `trials`?"),
        ({"rules": {"xyzzy": 5}}, "`$.rules`"),
    ],
)
def test_an_unknown_key_is_said_with_the_one_that_it_resembles(tree, said):
    with pytest.raises(MalformedError) as caught:
        convert(tree, Scenario)
    assert str(caught.value).endswith(said)
