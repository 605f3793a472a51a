"""The stub says what there is, and no more."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import decouplegs
from decouplegs import _native

STUB = Path(decouplegs.__file__).with_name("_native.pyi")
TYPES_ONLY = {"Layers", "StepResult", "Sweep"}
# A class that is Generic in the stub takes a type in brackets.
OF_EVERY_CLASS = set(dir(object)) | {"__module__", "__doc__", "__new__", "__class_getitem__"}


def test_every_name_is_in_the_stub_and_documented_there():
    tree = ast.parse(STUB.read_text())
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef) and node.name not in TYPES_ONLY}
    native = {name for name, value in vars(_native).items() if inspect.isclass(value)}
    assert native == set(classes)
    for name in native - {"Error", "DeviceError", "FileError", "TooManyHeldError"}:
        members = {node.name: node for node in classes[name].body if isinstance(node, ast.FunctionDef)}
        there = set(vars(getattr(_native, name))) - OF_EVERY_CLASS - {"__repr__"}
        assert there == set(members) - {"__init__"}, name
        silent = [member for member, node in members.items() if not ast.get_docstring(node) and not member.startswith("__")]
        assert not silent, (name, silent)


def literal(tree, name):
    """The strings of an alias `name = Literal[...]`."""
    alias = next(node for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == name)
    return [value.value for value in alias.value.slice.elts]


def test_planes_and_layers_of_the_stub_are_those_of_the_engine():
    with pytest.raises(ValueError, match="planes: expected names among") as refused:
        decouplegs.Session(planes=["none"])
    planes = re.search("among (.*), found", str(refused.value))[1].split(", ")
    text = STUB.read_text()
    tree = ast.parse(text)
    assert literal(tree, "PlaneName") == planes
    assert literal(tree, "LayerName") == ["color", *planes]
    layers = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Layers")
    assert [node.target.id for node in layers.body if isinstance(node, ast.AnnAssign)] == ["color", *planes]
    assert len(re.findall(r"layer: LayerName", text)) == len(re.findall(r"\blayer: ", text)) == 3


def test_the_package_is_typed_and_names_all():
    assert STUB.with_name("py.typed").exists()
    assert all(hasattr(decouplegs, name) for name in decouplegs.__all__)
