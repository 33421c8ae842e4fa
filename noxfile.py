#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.2.9"]
# ///
"""Tasks of contributors: `nox -l` lists them, and `nox -s smoke` runs one with the arguments after `--`."""

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv|virtualenv"


@nox.session(default=True)
def tests(session: nox.Session) -> None:
    """Run all tests except the slow ones, on all cores."""
    session.install("-e", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session(default=False)
def smoke(session: nox.Session) -> None:
    """Run one test of each main part, in at most two minutes."""
    session.install("-e", ".[test]")
    session.run("pytest", "-m", "smoke and not slow", *session.posargs)


@nox.session(default=False)
def slow(session: nox.Session) -> None:
    """Run the slow tests: more structures, methods, motions and pages."""
    session.install("-e", ".[test]")
    session.run("pytest", "-m", "slow", *session.posargs)


@nox.session(default=True)
def lint(session: nox.Session) -> None:
    """Check style, formatting, spelling and prose."""
    session.install("ruff>=0.14", "codespell>=2.4")
    session.run("ruff", "check", ".", *session.posargs)
    session.run("ruff", "format", "--check", ".")
    session.run("codespell")
    session.run("python", "tests/documentation/prose.py")


@nox.session(default=True)
def types(session: nox.Session) -> None:
    """Check static types."""
    session.install("-e", ".[dev]")
    session.run("pyright", *session.posargs)


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """Build the site in `site/`, with new reports of the gallery; `-- serve` shows the site and rebuilds it
    after changes."""
    session.install("-e", ".[docs]")
    session.run("python", "docs/reports.py")
    command = session.posargs or ["build", "--strict", "--site-dir", "site"]
    session.run("mkdocs", *command, env={"NO_MKDOCS_2_WARNING": "1"})


@nox.session(default=False)
def benchmarks(session: nox.Session) -> None:
    """Run one benchmark, for instance `-- cost motions`. Run nothing else on the machine meanwhile."""
    if not session.posargs:
        session.error("name a module of benchmarks/, for instance: nox -s benchmarks -- compare")
    session.install("-e", ".[bench]")
    name, *arguments = session.posargs
    session.run("python", "-m", f"benchmarks.{name}", *arguments)


@nox.session(default=False)
def notebooks(session: nox.Session) -> None:
    """Run the tests of all notebooks, on small grids."""
    session.install("-e", ".[test,notebook]")
    session.run("pytest", "tests/documentation/test_notebooks.py", *session.posargs)


if __name__ == "__main__":
    nox.main()
