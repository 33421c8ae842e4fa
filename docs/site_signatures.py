"""Signatures of the API reference: a Griffe extension and a hook of `mkdocs.yml`.

The packages do not import this module.
"""

from __future__ import annotations

import ast
from typing import Any

import griffe
from markupsafe import Markup
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    reference: Any = config.plugins["mkdocstrings"]
    reference.get_handler("python").env.filters["one_parameter_a_line"] = one_parameter_a_line
    return files


def one_parameter_a_line(signature: str) -> str:
    """Return a signature with one public parameter on each line. A signature with fewer than two parameters
    does not change."""
    signature = str(signature)
    parts, depth, quote, start = [], 0, "", 1
    for k, letter in enumerate(signature):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in "([{":
            depth += 1
        elif letter in ")]}":
            depth -= 1
        if not quote and (depth, letter) in ((1, ","), (0, ")")):
            parts.append(signature[start:k].strip())
            start = k + 1
            if depth == 0:
                break
    if len(parts) > 1:
        public = (part for part in parts if not part.startswith("_"))
        signature = "(\n" + "".join(f"    {part},\n" for part in public) + ")" + signature[start:]
    return Markup(signature)  # the formatter escapes it later


def _bases(cls: griffe.Class) -> set[str]:
    """Return the names of all bases that the package defines or names."""
    names: set[str] = set()
    for parent in (cls, *cls.mro()):
        names.update(str(base) for base in parent.bases)
    return names


def _fields(cls: griffe.Class) -> dict[str, griffe.Attribute]:
    """Return the fields of an Equinox module, those of its bases first."""
    found: dict[str, griffe.Attribute] = {}
    for parent in (*reversed(cls.mro()), cls):
        for name, member in parent.members.items():
            if (
                isinstance(member, griffe.Attribute)
                and member.annotation is not None
                and "property" not in member.labels
            ):
                constant = "class-attribute" in member.labels and "instance-attribute" not in member.labels
                if not constant and not name.startswith("_"):
                    found[name] = member
    return found


def _field_arguments(field: griffe.Attribute) -> dict[str, Any]:
    value = field.value
    if isinstance(value, griffe.ExprCall) and str(value.function).endswith("field"):
        return {item.name: item.value for item in value.arguments if isinstance(item, griffe.ExprKeyword)}
    return {} if value is None else {"default": value}


class Signatures(griffe.Extension):
    """Give Equinox modules a signature made of their fields, and members of enumerations their text as
    docstring."""

    def on_package(self, *, pkg: griffe.Module, **kwargs: Any) -> None:
        del kwargs
        self._walk(pkg)

    def _walk(self, module: griffe.Module) -> None:
        for member in list(module.members.values()):
            if member.is_alias:
                continue
            if isinstance(member, griffe.Module):
                self._walk(member)
            elif isinstance(member, griffe.Class):
                self._treat(member)

    def _treat(self, cls: griffe.Class) -> None:
        if "__doc__" in cls.members:  # computed at import
            cls.docstring = griffe.Docstring(griffe.dynamic_import(cls.path).__doc__, parent=cls)
        bases = _bases(cls)
        if "eqx.Enumeration" in bases:
            for member in cls.members.values():
                if isinstance(member, griffe.Attribute) and member.value is not None:
                    member.docstring = griffe.Docstring(ast.literal_eval(str(member.value)), parent=member)
                    member.value, member.labels = None, set()
        elif "eqx.Module" in bases and "__init__" not in cls.members:
            self._add_signature(cls)

    def _add_signature(self, cls: griffe.Class) -> None:
        arguments = {name: _field_arguments(field) for name, field in _fields(cls).items()}
        # Users create classes that check or convert their fields; other classes are results.
        checks = any("__check_init__" in parent.members for parent in (cls, *cls.mro()))
        if not checks and not any("converter" in given for given in arguments.values()):
            return
        positional = griffe.ParameterKind.positional_or_keyword
        parameters = [griffe.Parameter("self", kind=positional)]
        for name, field in _fields(cls).items():
            default = arguments[name].get("default")
            parameters.append(
                griffe.Parameter(name, annotation=field.annotation, kind=positional, default=default)
            )
        made = griffe.Function("__init__", parameters=griffe.Parameters(*parameters), parent=cls)
        cls.set_member("__init__", made)
