"""Import of users' files that define a problem or a contact law, and checks of these files."""

from __future__ import annotations

import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Annotated, Any, cast, get_type_hints

import casadi as ca
import numpy as np
from pydantic import AfterValidator, BaseModel, Field

from dynamics.contact import ContactLaw
from ocp.errors import InputError, abbreviated
from ocp.transcription.factories import contact_law
from ocp.validation import Line, Recorded, validated
from problems.drawing import ContactFrame, Shape
from problems.source_digest import folder_modules, open_to_imports
from problems.spec import Citation, Golden, ProblemSpec, describe, spec_from_module
from problems.user_code import guarded, reason, user_code


def import_file(path: Path) -> ModuleType:
    """Import the module at the absolute ``path``, even if it was imported before.

    The file may import modules from its folder. All these modules are imported again if any of them has
    changed or was imported from another folder.

    Raises :class:`~ocp.errors.InputError` if there is no such file, or if the file raises.
    """
    check_file(path)
    name = f"user_problem_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_SourceLoader(name, str(path)))
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: not a Python file; expected one that defines a problem or a law")
    module = importlib.util.module_from_spec(spec)
    # pydantic looks up a model's annotations in sys.modules.
    sys.modules[spec.name] = module
    open_to_imports(path.parent)
    _forget_others(path)
    with user_code("the file raised at", path), _no_bytecode():
        spec.loader.exec_module(module)
    return module


def check_file(path: Path) -> None:
    """Raise :class:`~ocp.errors.InputError` unless ``path`` is an existing regular file."""
    if not path.is_file():
        file_kind = "is a directory" if path.is_dir() else "is not a regular file"
        kind = file_kind if path.exists() else "there is no such file"
        raise InputError(f"{path}: {kind}; expected a Python file that defines a problem or a law")


class _SourceLoader(SourceFileLoader):
    """Loader that ignores cached bytecode, since Python compares only the source's size and time in whole seconds."""

    def get_code(self, fullname: str) -> CodeType:
        content = self.get_data(self.path)
        return cast("CodeType", self.source_to_code(content, self.path))


@contextmanager
def _no_bytecode() -> Iterator[None]:
    """Prevent Python from writing bytecode of the modules that a user's file imports; see :class:`_SourceLoader`."""
    setting, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = setting


_contents: dict[str, tuple[str, str]] = {}
"""Mapping from the name of a module in a user's folder to its file and digest at the last import."""


def _forget_others(path: Path) -> None:
    """Remove the user's modules that ``path`` imports from ``sys.modules`` if one of them has changed or moved."""
    modules = folder_modules(path)
    from ocp.store.provenance import file_digest

    contents = {name: (str(file), file_digest(file)) for name, file in modules.items()}
    loaded = {name: file for name in contents if (file := _loaded_from(name))}
    if any(_contents.get(name, (file, contents[name][1])) != contents[name] for name, file in loaded.items()):
        for name in loaded:
            del sys.modules[name]
    _contents.update(contents)


def _loaded_from(name: str) -> str:
    """Return the file of the loaded module ``name`` if it is from a user's folder, else "".

    Standard and installed modules always give "", since the whole program uses them.
    """
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None or name in sys.stdlib_module_names or "site-packages" in Path(file).parts:
        return ""
    return str(file)


def check(spec: ProblemSpec) -> None:
    """Build the problem at its default parameters and evaluate every part once.

    Raises :class:`~ocp.errors.InputError`, with the part whose dimension or value is wrong in its message.
    """
    problem = spec.problem()
    p = problem.parameters.values
    system = problem.system
    evaluations = {"system": lambda: system.reduced, "guess": lambda: problem.initial_guess(p)}
    for part, evaluate in evaluations.items():
        try:
            evaluate()
        except Exception as error:
            message = reason(error).removeprefix(f"{spec.path}: ")
            raise InputError(f"{spec.path}: the {part} does not fit: {message}") from error
    start = problem.initial_states(p)
    if not np.all(np.isfinite(start)):
        raise InputError(f"{spec.path}: x0 is not finite: {start[0]}")
    cost = np.array(problem.cost_terms(start[0], np.zeros(system.nu), np.zeros(system.nu), 0, p))
    if not np.all(np.isfinite(cost)):
        raise InputError(f"{spec.path}: the cost is not a finite number at x0 and u = 0")
    s, symbols = problem.system, problem.parameters.vector
    residuals = ca.Function("step", [s.x, s.u, s.x_next, s.lam, symbols], [ca.vertcat(s.residual, s.gap)])
    if not np.all(np.isfinite(np.array(residuals(start[0], 0, start[0], 0, p)))):
        raise InputError(f"{spec.path}: residual or gap is not finite at x0, u = 0 and lam = 0")
    params = spec.params({})
    for drawing in (spec.draw, spec.frames):
        if drawing is not None:
            drawing(params, start[0])
    _check_words(spec, params)


def _check_words(spec: ProblemSpec, params: BaseModel) -> None:
    """Reject parameter values that a run cannot store, and names and descriptions that a terminal cannot show."""
    for about in describe(spec):
        parameter = f"parameter {validated(f'{spec.path}: a parameter', about['name'], Line)}"
        for key in ("unit", "description"):
            validated(f"{spec.path}: the {key} of {parameter}", about[key], Line)
    for name, value in params.model_dump().items():
        validated(f"{spec.path}: parameter {name}", value, Recorded)


REQUIRED_NAMES = ("name", "title", "Params", "build")
"""Names that a problem's file must define."""
LONGEST_NAME = 100
"""Maximum number of characters in the name of a problem or a law."""


def check_name(name: str) -> str:
    """Return the name of a problem or a law unchanged; raise ValueError unless it is one word."""
    if not re.fullmatch(r"\w[\w.-]*", name) or len(name) > LONGEST_NAME:
        raise ValueError(
            "a name must be a word of letters, digits, '-' and '_', of at most"
            f" {LONGEST_NAME} characters, got {abbreviated(name)}"
        )
    return name


def _lines(text: str) -> str:
    if not all(line.replace("\t", " ").isprintable() for line in text.splitlines()):
        raise ValueError("must be a text in typst's mathematics without control characters")
    return text


def _plain_function(function: Any) -> Any:
    if inspect.isgeneratorfunction(function) or inspect.iscoroutinefunction(function):
        raise ValueError("must be a plain function, without yield or async")
    return function


def _parameters(kind: Any) -> Any:
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        raise ValueError("must be a class derived from problems.Parameters (a pydantic model)")
    return kind


_Function = Annotated[Callable[..., Any], AfterValidator(_plain_function)]
_MaybeFunction = Annotated[Callable[..., Any] | None, AfterValidator(_plain_function)]
DEFINED_TYPES: dict[str, Any] = {
    "name": Annotated[Line, AfterValidator(check_name)],
    "title": Line,
    "Params": Annotated[Any, AfterValidator(_parameters)],
    "build": _Function,
    "equations": Annotated[str, Field(strict=True), AfterValidator(_lines)],
    "citation": Citation | None,
    "axes": tuple[Line, Line],
    "golden": dict[Line, Golden],
    "draw": _MaybeFunction,
    "frames": _MaybeFunction,
    "region": _MaybeFunction,
}
"""Mapping from each name that a problem's file may define to its required type."""
CALLS = {
    "build": ("build(params)", None),
    "draw": ("draw(params, state)", list[Shape]),
    "frames": ("frames(params, state)", list[ContactFrame]),
    "region": ("region(params)", None),
}
"""Mapping from a function in a problem's file to its call (for messages) and the required type of its result."""


def read(module: ModuleType, file: Path, digest: str) -> ProblemSpec:
    """Return the specification of the problem in ``module``, which was imported from ``file`` with this digest.

    The functions are wrapped so that they raise only :class:`~ocp.errors.InputError`.

    Raises :class:`~ocp.errors.InputError` if a name is missing or has the wrong type.
    """
    missing = [key for key in REQUIRED_NAMES if not hasattr(module, key)]
    if missing:
        raise InputError(
            f"{file}: the file must define {', '.join(REQUIRED_NAMES)};"
            f" {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        )
    for key, kind in DEFINED_TYPES.items():
        if hasattr(module, key):
            setattr(module, key, validated(f"{file}: {key}", getattr(module, key), kind))
    spec = spec_from_module(ProblemSpec, module, path=file, digest=digest)
    for key, (call, kind) in CALLS.items():
        if function := getattr(spec, key):
            check = kind and partial(validated, "it", kind=kind)
            spec = replace(spec, **{key: guarded(function, call, file, check)})
    return spec


def read_law(module: ModuleType, file: Path, digest: str) -> type[ContactLaw]:
    """Return the class of the contact law in ``module``, which was imported from ``file`` with this digest.

    Its functions are wrapped so that they raise only :class:`~ocp.errors.InputError`.

    Raises :class:`~ocp.errors.InputError` if there is no law, if there are several, or if a part of the law is missing.
    """
    from dynamics.laws import LAWS

    laws = (kind for kind in vars(module).values() if inspect.isclass(kind) and issubclass(kind, ContactLaw))
    classes = [*dict.fromkeys(law for law in laws if law.__module__ == module.__name__)]
    if len(classes) != 1:
        raise InputError(
            f"{file}: the file must define one class derived from dynamics.contact.ContactLaw;"
            f" found {', '.join(law_class.__name__ for law_class in classes) or 'none'}"
        )
    law = classes[0]
    if missing := [*sorted(law.__abstractmethods__), *(k for k in LAW_TYPES if not hasattr(law, k))]:
        raise InputError(f"{file}: {law.__name__} must define {', '.join(missing)}")
    for key, kind in LAW_TYPES.items():
        validated(f"{file}: {law.__name__}.{key}", getattr(law, key), kind)
    if law.name in LAWS:
        raise InputError(f"{file}: there is a law called {law.name} already; choose another name")
    _check_types(law, file)
    for name, function in list(vars(law).items()):
        if inspect.isfunction(function):
            through = ValueError if name == "__init__" else ()
            call = f"{law.__name__}.{name}(...)"
            setattr(law, name, guarded(function, call, file, through=through))
    law.source, law.source_digest = str(file), digest
    law.__reduce__ = lambda self: (contact_law, (str(file), self.settings()))
    return law


LAW_TYPES: dict[str, Any] = {"name": Annotated[Line, AfterValidator(check_name)], "summary": Line}
"""Mapping from each attribute that the class of a law must define to its type."""


def _check_types(law: type[ContactLaw], file: Path) -> None:
    with user_code(f"the types of {law.__name__}.__init__ cannot be read:", file):
        hints = get_type_hints(law.__init__)
    for name, argument in inspect.signature(law).parameters.items():
        if name not in hints or argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            raise InputError(
                f"{file}: {law.__name__}.__init__ must say the type of each setting; write {name}:"
                " float = 0.01, for example"
            )
