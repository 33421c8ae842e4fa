#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.2.9"]
# ///
"""Tasks of contributors: `nox -l` lists them, `nox -s smoke` runs one, arguments after `--` are passed on."""

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv|virtualenv"


@nox.session(default=True)
def tests(session: nox.Session) -> None:
    """The tests but for the slow ones, on all cores."""
    session.install("-e", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session(default=False)
def smoke(session: nox.Session) -> None:
    """One test of each main part, in at most two minutes."""
    session.install("-e", ".[test]")
    session.run("pytest", "-m", "smoke and not slow", *session.posargs)


@nox.session(default=False)
def slow(session: nox.Session) -> None:
    """The slow tests: more structures, methods, motions and pages."""
    session.install("-e", ".[test]")
    session.run("pytest", "-m", "slow", *session.posargs)


@nox.session(default=True)
def lint(session: nox.Session) -> None:
    """Style, formatting, spelling and prose."""
    session.install("ruff>=0.14", "codespell>=2.4")
    session.run("ruff", "check", ".", *session.posargs)
    session.run("ruff", "format", "--check", ".")
    session.run("codespell")
    session.run("python", "tests/documentation/prose.py")


@nox.session(default=True)
def types(session: nox.Session) -> None:
    """Static types."""
    session.install("-e", ".[dev]")
    session.run("pyright", *session.posargs)


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """The site, into `site/`; `-- serve` shows it and follows changes."""
    session.install("-e", ".[docs]")
    command = session.posargs or ["build", "--strict", "--site-dir", "site"]
    session.run("mkdocs", *command, env={"NO_MKDOCS_2_WARNING": "1"})


@nox.session(default=False)
def benchmarks(session: nox.Session) -> None:
    """One benchmark, for instance `-- cost motions`; leave the machine alone while it runs."""
    if not session.posargs:
        session.error("which one? A module of benchmarks/, for instance: nox -s benchmarks -- compare")
    session.install("-e", ".[bench]")
    name, *arguments = session.posargs
    session.run("python", "-m", f"benchmarks.{name}", *arguments)


@nox.session(default=False)
def notebooks(session: nox.Session) -> None:
    """All notebooks, on small grids, as the tests run them."""
    session.install("-e", ".[test,notebook]")
    session.run("pytest", "tests/documentation/test_notebooks.py", *session.posargs)


if __name__ == "__main__":
    nox.main()
