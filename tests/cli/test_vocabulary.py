"""One vocabulary: an option means the same thing, and takes the same kind of value, wherever a command has it."""

from collections.abc import Iterator
from typing import get_args

import pytest
from cyclopts import App

from dopslam.cli import app
from dopslam.cli.failure import EARLIER

# Option → kind of value, and what it means everywhere. An option that is not listed here is new: give it a meaning of its own.
MEANINGS = {
    "--out": ("Path", "what the command makes: a file, or a folder"),
    "--json": ("Path", "file that gets the figures"),
    "--csv": ("Path", "file that gets the figures of every step"),
    "--set": ("list", "a scenario key, key.path=value, may be repeated"),
    "--filter": ("list", "names of filters, repeated or with commas"),
    "--runs": ("int", "number of Monte Carlo runs"),
    "--seed": ("int", "of everything random"),
    "--jobs": ("int", "worker processes, one for each core by default"),
    "--cluster": ("str", "address of a Dask scheduler"),
    "--particles": ("int", "of belief propagation"),
    "--source": ("Literal", "where detections come from"),
    "--scene": ("str", "folder with scenario.toml, or a shipped scene"),
    "--dataset": ("Path", "dataset file, or folder of shards"),
    "--doppler-std": ("number", "m/s"),
    "--prior": ("Literal", "how the spread of the start is read"),
    "--truth": ("Path", "folder of a suite's truth"),
    "--suite": ("Path", "folder of a frozen suite"),
    # of one command alone
    "--answer": ("Path", "of score"), "--name": ("str", "of score, in the board"), "--split": ("str", "of benchmark run"),
    "--scenes": ("int", "of benchmark make"), "--seeds": ("int", "of benchmark make"), "--steps": ("int", "of benchmark make"),
    "--first": ("int", "of benchmark make"), "--kind": ("str", "of new"), "--from": ("Path", "of new"),
    "--scale": ("float", "of new"), "--carrier": ("str", "of new, Hz"), "--bandwidth": ("str", "of new, Hz"),
    "--height": ("float", "of new, m"), "--wall": ("str", "of new"), "--keep-signal": ("bool", "of run"),
    "--visibility": ("str", "of bound"), "--information": ("Literal", "of bound"), "--contributions": ("Path", "of bound"),
    "--plan": ("Path", "of sweep"), "--results": ("Path", "of view, a folder or a file in it"), "--open": ("bool", "of view"), "--serve": ("bool", "of view"), "--positions": ("int", "of dataset"),
    "--resume": ("bool", "of dataset"), "--signal": ("bool", "the received signal is kept too"), "--detections": ("bool", "of dataset"),
    "--path": ("str", "of check"), "--table": ("Path", "of import"), "--map": ("Path", "of import"),
    "--track": ("Path", "of import"), "--to": ("str", "of export"), "--format": ("str", "of import"), "--drive": ("int", "of export"), "--origin": ("str", "of export, latitude and longitude"),
    "--prefix": ("str", "of keys"), "--align": ("bool", "of evaluate"), "--estimator": ("str", "of benchmark run"),
}  # fmt: skip


def commands(group: App, above: tuple[str, ...] = ()) -> Iterator[tuple[str, App]]:
    """Every command that does something, by its words."""
    for name in group:
        if name.startswith("-"):
            continue
        command, words = group[name], (*above, name)
        if command.default_command is not None:
            yield " ".join(words), command
        yield from commands(command, words)


COMMANDS = dict(commands(app))


def kind_of(hint) -> str:
    """The kind of value of an annotation, None left aside."""
    if getattr(hint, "__origin__", None) is not None and hasattr(hint, "__metadata__"):
        return kind_of(hint.__origin__)
    parts = [part for part in get_args(hint) if part is not type(None)]
    if type(None) in get_args(hint) and len(parts) == 1:
        return kind_of(parts[0])
    if getattr(hint, "__origin__", None) is not None and "Literal" in str(hint.__origin__):
        return "Literal"
    return getattr(getattr(hint, "__origin__", hint), "__name__", str(hint))


@pytest.mark.parametrize("command", COMMANDS)
def test_an_option_is_called_and_means_the_same_everywhere(command):
    for argument in COMMANDS[command].assemble_argument_collection():
        option = argument.names[0]
        if not option.startswith("--"):
            continue
        assert option in MEANINGS, f"{command} {option}: give it a meaning in this table, or the name of what it means"
        kind = MEANINGS[option][0]
        assert kind_of(argument.hint) in (("str", "float") if kind == "number" else (kind,)), f"{command} {option}"


def test_no_meaning_is_left_that_no_command_has():
    had = {argument.names[0] for command in COMMANDS.values() for argument in command.assemble_argument_collection()}
    assert set(MEANINGS) <= had


@pytest.mark.parametrize(("command", "earlier"), EARLIER)
def test_an_earlier_spelling_answers_with_the_present_one(command, earlier, call, capsys):
    assert call(command, "ring_road", earlier, "x") == 2
    said = capsys.readouterr().err
    assert f"{command} {earlier} is now called {EARLIER[command, earlier]}" in said and said.count("\n") == 1
    present = {name for argument in COMMANDS[command].assemble_argument_collection() for name in argument.names}
    assert EARLIER[command, earlier] in present and earlier not in present
