"""The stub says what there is, and no more."""

import ast
import inspect
from pathlib import Path

import decouplegs
from decouplegs import _native

STUB = Path(decouplegs.__file__).with_name("_native.pyi")
TYPES_ONLY = {"Layers", "StepResult", "Sweep"}
OF_EVERY_CLASS = set(dir(object)) | {"__module__", "__doc__", "__new__"}


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


def test_the_package_is_typed_and_names_all():
    assert STUB.with_name("py.typed").exists()
    assert all(hasattr(decouplegs, name) for name in decouplegs.__all__)
