"""Registry of estimators: installed entry points, and users' files.

A text ``NAME`` or ``NAME[parameter=value,...]`` describes an estimator. NAME is one of these:

- the name of an entry point in the group ``ggbench.estimators`` or ``ggbench.frameworks``,
- the path of a Python file that defines one :class:`~ggbench.problem.Estimator`,
- the path of a file or folder of estimates,
- ``exec:`` and the path of a program.
"""

from __future__ import annotations

import ast
import difflib
import hashlib
import importlib.metadata
import inspect
import sys
import types
import typing
from collections.abc import Iterable
from dataclasses import MISSING, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from ..errors import GGBenchError
from ..estimator_spec import EstimatorSpec
from ..exchange import PROGRAM
from ..exchange.containers import SUFFIXES
from ..figures.numbers import some
from ..parameters import parameters_of
from ..problem import Causality, Estimator, Family
from ..spec.rosters import expanded
from .foreign_changes import OWN_MODULE, put_back
from .truth_isolation import suspicious_names

GROUP = "ggbench.estimators"
FRAMEWORKS = "ggbench.frameworks"
"""Entry points of estimators that need another package, each with an extra."""
_SOURCE = "__ggbench_source__"
_ADAPTERS = "ggbench.adapters."
"""Prefix of the names of modules that adapt other packages' estimators."""
_SHIPPED = ("ggbench.estimators.", _ADAPTERS)
"""Prefixes of the names of modules of shipped estimators."""


class EstimatorError(GGBenchError):
    """An estimator cannot be found, or its parameters are invalid."""


@dataclass(frozen=True)
class Choice:
    """A chosen estimator; ``spec`` has its name and the parameters that differ from defaults."""

    spec: EstimatorSpec
    estimator: Estimator

    @property
    def label(self) -> str:
        """Text that identifies the estimator in results, such as ``ukf[points=merwe]``."""
        return str(self.spec)

    @property
    def family(self) -> Family:
        """Family of the estimator class; "own" unless the class is shipped with this package."""
        cls = type(self.estimator)
        return cls.family if cls.__module__.startswith(_SHIPPED) else "own"

    @cached_property  # each run asks for it
    def content(self) -> dict[str, Any]:
        """Origin of the estimator's results: class, all parameters, hash of the source file.

        If an estimator uses other packages through adapters, the versions of these packages are
        included. Names in the source that give access to the truth are included too
        (:func:`.suspicious_names`).
        """
        cls = type(self.estimator)
        source, seeks = source_of(cls)
        libraries = _libraries_of(cls)
        return {
            "class": cls.__qualname__,
            "parameters": {name: getattr(self.estimator, name) for name in parameters_of(cls)},
            "source": source,
            **({"libraries": libraries} if libraries else {}),
            **({"seeks": list(seeks)} if seeks else {}),
        }


def registered() -> dict[str, type[Estimator]]:
    """Return the registered estimator classes by name.

    Raise EstimatorError if an installed entry point cannot be imported.
    """
    return {name: _load(point) for name, point in estimator_points().items()}


@cache
def estimator_points() -> dict[str, importlib.metadata.EntryPoint]:
    """Return the entry points of the registered estimators by name, sorted.

    The result is cached, because reading the entry points of all packages takes 50 ms.
    """
    points = importlib.metadata.entry_points(group=GROUP)
    return {point.name: point for point in sorted(points, key=lambda p: p.name)}


@cache
def framework_points() -> dict[str, importlib.metadata.EntryPoint]:
    """Return the entry points of other packages' estimators by name, sorted."""
    points = importlib.metadata.entry_points(group=FRAMEWORKS)
    return {point.name: point for point in sorted(points, key=lambda p: p.name)}


def _load(point: importlib.metadata.EntryPoint) -> type[Estimator]:
    try:
        cls: type[Estimator] = point.load()
    except Exception as error:
        raise EstimatorError(
            f"the estimator '{point.name}' ({point.value}) cannot be imported: {error}"
        ) from error
    return cls


def choose(text: str) -> Choice:
    """Return the estimator that a text ``NAME`` or ``NAME[parameter=value,...]`` describes.

    Raise EstimatorError if the text, the name, the file or a parameter is invalid; the message
    states the allowed values.
    """
    try:
        text.encode()
    except UnicodeEncodeError:  # halves of characters, as file names of other bytes have them
        raise EstimatorError(
            f"{text!a} contains characters that are not Unicode: rename the file of the estimator"
        ) from None
    if "\0" in text:
        raise EstimatorError(f"{text!a} contains a null character")
    spec = _parsed(text)
    name = spec.name
    if name.endswith(".py"):
        cls = _from_file(Path(name))
    elif name.startswith(PROGRAM):
        from ..exchange import programs  # not at the top: few need it

        cls = programs.estimator_of(name)
    elif _holds_estimates(name):
        from ..exchange import estimate_files

        cls = estimate_files.estimator_of(Path(name))
    else:
        # Of these only the chosen one is imported: some load slowly.
        points = estimator_points() | framework_points()
        if name not in points:
            close = difflib.get_close_matches(name, points, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise EstimatorError(
                f"there is no estimator '{name}'{hint}; known: {', '.join(points)}; "
                "or give the path of a .py file or of estimates, or exec:PROGRAM"
            )
        cls = _load(points[name])
    _require_interface(cls, name)
    return Choice(*_made(cls, spec))


def _made(cls: type[Estimator], requested: EstimatorSpec) -> tuple[EstimatorSpec, Estimator]:
    """Return the spec and the instance of an estimator with the parameters that a text states."""
    name, declared = requested.name, parameters_of(cls)
    defaults = {key: parameter.default for key, parameter in declared.items()}
    values = dict(defaults)
    for key, text in requested.parameters.items():
        if key not in declared:
            allowed = ", ".join(declared) or "it has none"
            raise EstimatorError(f"{name} has no parameter '{key}'; its parameters: {allowed}")
        try:
            values[key] = declared[key].validate(text)
        except ValueError:
            raise EstimatorError(
                f"{name}: parameter '{key}' is '{text}' and must be {declared[key].allowed()}"
            ) from None
    spec = EstimatorSpec.changed(name, values, defaults)
    try:
        estimator = cls(**values)
        causality = estimator.causality
    except Exception as error:
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise EstimatorError(f"{name} does not accept '{spec.listed}': {reason}") from error
    if causality not in typing.get_args(Causality):
        raise EstimatorError(
            f"{name}: causality is {causality!r} and must be one of "
            f"{', '.join(typing.get_args(Causality))}"
        )
    if causality == "fixed-lag" and "lag" not in declared:
        raise EstimatorError(f"{name}: a fixed-lag estimator needs a parameter 'lag' [s]")
    return spec, estimator


def spec_of(estimator: Estimator) -> EstimatorSpec:
    """Return the spec (name and parameters) of an estimator object.

    Raise EstimatorError unless the class is registered, or is from a file that :func:`choose` has
    read. The error is also raised if this file has changed since, or if a parameter cannot be
    written as text.
    """
    cls = type(estimator)
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    if cls.__module__.startswith(OWN_MODULE):
        name = str(file)
    else:
        place = f"{cls.__module__}:{cls.__qualname__}"
        points = estimator_points() | framework_points()
        names = [name for name, point in points.items() if point.value == place]
        if not names:
            raise EstimatorError(
                f"worker processes cannot import the class {cls.__name__} of {cls.__module__}: "
                "put it into a file and give its path, or use simulate, estimate and judge"
            )
        name = names[0]
    defaults = {key: parameter.default for key, parameter in parameters_of(cls).items()}
    values = {key: getattr(estimator, key) for key in defaults}
    spec = EstimatorSpec.changed(name, values, defaults)
    if choose(str(spec)).estimator != estimator:
        raise EstimatorError(
            f"the estimator {estimator!r} cannot be recreated from '{spec}': its file has changed "
            "since it was loaded, or a parameter is not a plain number or text"
        )
    return spec


def choose_all(texts: Iterable[str]) -> list[Choice]:
    """Return the estimators of several texts, without duplicates.

    If several texts describe equal estimators, only the first text is used; it becomes the label.
    ``@NAME`` stands for all estimators of a roster, a named set of estimators. Raise EstimatorError
    as :func:`choose` does, or if a roster does not exist.
    """
    chosen: list[Choice] = []
    for choice in map(choose, listed(texts)):
        if all(choice.content != other.content for other in chosen):
            chosen.append(choice)
    return chosen


def listed(texts: Iterable[str]) -> tuple[str, ...]:
    """Return texts without duplicates; the estimators of a roster replace its text ``@NAME``.

    ``-TEXT`` removes an estimator that is listed before. Raise EstimatorError if a roster does not
    exist, or an estimator to remove is not listed before.
    """
    try:
        return expanded(texts)
    except ValueError as error:
        raise EstimatorError(f"{error}") from None


def is_own(text: str) -> bool:
    """Return True if a text names a file, folder or program, False for an installed estimator.

    Raise EstimatorError if the text is not of the form ``NAME`` or ``NAME[parameter=value,...]``.
    """
    name = _parsed(text).name
    return name.endswith(".py") or name.startswith(PROGRAM) or _holds_estimates(name)


@cache  # asked of every label in every case
def own_file(label: str) -> str:
    """Return the path of the user's Python file in a label, or "" if there is none."""
    name = _parsed(label).name
    return name if name.endswith(".py") else ""


def _holds_estimates(name: str) -> bool:
    if Path(name).suffix in SUFFIXES:
        return True
    # An installed name stays what it is, whatever folders are here.
    return name not in estimator_points() | framework_points() and Path(name).is_dir()


def _parsed(text: str) -> EstimatorSpec:
    try:
        return EstimatorSpec.parse(text)
    except ValueError as error:
        raise EstimatorError(str(error)) from None


def _require_interface(cls: type[Estimator], name: str) -> None:
    """Raise EstimatorError unless a class is a named dataclass whose parameters have defaults."""
    if not isinstance(getattr(cls, "name", None), str) or not cls.name:
        raise EstimatorError(f"{name}: the class {cls.__name__} needs a text 'name'")
    if not cls.name.isprintable():
        raise EstimatorError(
            f"{name}: the name of the class {cls.__name__} is {cls.name!a} and must be printable"
        )
    if "__dataclass_fields__" not in vars(cls):
        raise EstimatorError(
            f"{name}: the class {cls.__name__} needs the decorator @dataclass(frozen=True)"
        )
    for key, (_, default) in parameters_of(cls).items():
        if default is MISSING:
            raise EstimatorError(f"{name}: the parameter '{key}' needs a default")
        if not isinstance(default, bool | int | float | str | None):
            raise EstimatorError(
                f"{name}: the parameter '{key}' is {default!r}; it must be a number, a text or a "
                "truth value"
            )


@cache
def source_of(cls: type[Estimator]) -> tuple[str, tuple[str, ...]]:
    """Return the source hash of a class, and names in the source that give access to the truth.

    The hash covers the file of the class and the modules that it imports from the same package or
    from the adapters. In installed modules only the code counts, not docstrings and comments.
    """
    module = sys.modules[cls.__module__]
    if "path" in vars(cls):  # of a program, or a file of estimates
        files = [vars(cls)["path"]]
        if files[0].is_dir():
            files = sorted(files[0].iterdir())
        contents = [file.read_bytes() for file in files if file.is_file()]
        return hashlib.sha256(b"".join(contents)).hexdigest(), ()
    contents, installed = [], _adapters_of(cls)
    if _SOURCE in vars(module):
        contents = [vars(module)[_SOURCE]]
    else:
        modules = {cls.__module__}
        if module.__package__:
            modules |= {n for n in _used_by(cls) if n.startswith(f"{module.__package__}.")}
        installed += [name for name in sorted(modules) if name in sys.modules]
    sources = [content_of(name) for name in installed]
    seeks = {name for content in (*contents, *sources) for name in suspicious_names(content)}
    code = b"".join((*contents, *map(code_of, sources)))
    return hashlib.sha256(code).hexdigest(), tuple(sorted(seeks))


def _used_by(cls: type[Estimator]) -> set[str]:
    """Return the names of the modules that define a class's bases and the objects in its file."""
    objects = [*vars(sys.modules[cls.__module__]).values(), *cls.__mro__]
    named = (x.__name__ if inspect.ismodule(x) else getattr(x, "__module__", None) for x in objects)
    return {str(name) for name in named}


def _adapters_of(cls: type[Estimator]) -> list[str]:
    """Return the names of the adapters to other packages that a class uses."""
    return sorted(name for name in _used_by(cls) if name.startswith(_ADAPTERS))


def _libraries_of(cls: type[Estimator]) -> dict[str, str]:
    """Return the versions of the packages that a class uses through adapters."""
    names = [name for one in _adapters_of(cls) for name in sys.modules[one].LIBRARIES]
    return {name: importlib.metadata.version(name) for name in names}


def code_of(source: bytes) -> bytes:
    """Return a module's syntax tree as bytes, without docstrings, comments and layout.

    If the source is no valid Python, return it unchanged.
    """
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return source
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [part for part in node.body if not _is_text(part)]
    return ast.dump(tree).encode()


def _is_text(statement: ast.stmt) -> bool:
    """Return whether a statement is only a string: a docstring, of an attribute too."""
    if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
        return False
    return isinstance(statement.value.value, str)


def content_of(module: str) -> bytes:
    """Return the source of an imported module."""
    return Path(inspect.getfile(sys.modules[module])).read_bytes()


def _from_file(path: Path) -> type[Estimator]:
    """Import a file and return the one estimator class that it defines."""
    try:
        source = path.read_bytes()
    except OSError as error:
        raise EstimatorError(f"cannot read estimator file {path}: {error.strerror}") from None
    # The same file is imported once; two files of one name do not collide.
    module_name = f"{OWN_MODULE}{hashlib.sha256(source + str(path).encode()).hexdigest()[:16]}"
    module = sys.modules.get(module_name)
    if module is None:
        # Not by an import: a cached byte code could be older than what is hashed here.
        module = types.ModuleType(module_name)
        module.__file__ = str(path)
        vars(module)[_SOURCE] = source
        sys.modules[module_name] = module
        replaced: list[str] = []
        try:
            with put_back(replaced):
                exec(compile(source, str(path), "exec"), vars(module))
        except (Exception, SystemExit) as error:
            del sys.modules[module_name]
            raise EstimatorError(
                f"{path} cannot be imported: {type(error).__name__}: {error}"
            ) from error
        if replaced:
            del sys.modules[module_name]
            raise EstimatorError(
                f"{path} replaces {some(replaced)} when it is imported; an estimator must leave "
                "functions of other modules as they are"
            )
    classes = [
        item
        for item in vars(module).values()
        if inspect.isclass(item)
        and issubclass(item, Estimator)
        and not inspect.isabstract(item)
        and item.__module__ == module_name
    ]
    if len(classes) != 1:
        raise EstimatorError(
            f"{path} defines {len(classes)} estimators; it must define exactly one class that "
            "derives from ggbench.problem.Estimator, with causality and estimate"
        )
    return classes[0]
