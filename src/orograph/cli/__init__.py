"""The command line: one file per verb, loaded only when it is called."""

from __future__ import annotations

from orograph.cli import stopping

stopping.guard_imports()  # before anything else is loaded

# ruff: noqa: E402
import errno
import importlib
import os
import sys
import traceback
from typing import Any, NoReturn

import click

from orograph._spared import spare_imports
from orograph.errors import OrographError

VERBS = {
    "best-view": "Find the views that show most of a target.",
    "demo": "Draw the built-in sample, step by step.",
    "build": "Build a terrain store from DEM files.",
    "fetch": "Fetch open elevation models by place.",
    "check": "Read all of a store and list what is damaged.",
    "publish": "Copy a finished store into a bucket.",
    "export": "Write heights, or data on the ground, for other tools.",
    "contours": "Write contour lines as vectors.",
    "difference": "Compute the difference of two DEMs of the same place.",
    "bake": "Bake light into a store: sky, occlusion, apertures.",
    "info": "Describe a DEM or a store, and point out what looks suspicious.",
    "manifest": "Describe many DEM files once, for the other verbs.",
    "movie": "Film a tour of a DEM or a store.",
    "tour": "Make a tour: key frames for a movie.",
    "render": "Draw a relief picture of a DEM or a store.",
    "view": "Explore a DEM or a store in a window.",
    "light": "Make maps of light: slope, hillshade, horizons, sky, openness…",
    "measure": "Measure heights, lengths, areas and visibility.",
    "tessellate": "Triangulate a DEM or a store for a view.",
    "tin": "Triangulate a DEM or a store within an error in metres (TIN).",
    "compare": "Measure methods side by side.",
    "methods": "List the methods, and what their options mean.",
    "doctor": "Report what this machine can draw with, and what is missing.",
    "synth": "Make a fractal terrain of any size.",
}

EPILOG = """\b
Exit codes: 0 done · 1 a fault of Orograph itself, or a bound that compare finds broken · 2 wrong command line ·
3 input cannot be read · 4 output or store cannot be written or is damaged ·
5 nothing to draw in view · 6 no usable GPU · 130 interrupted."""


class Verbs(click.Group):
    """Imports a verb's module only when it is needed: ``orograph info`` does not wait for the renderer."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        command: click.Command = importlib.import_module(f"orograph.cli.{cmd_name.replace('-', '_')}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in VERBS and not name.startswith("-"):
            import difflib  # late, as what compiles is: most commands need neither

            close = _wording().elsewhere(name) or difflib.get_close_matches(name, VERBS, 2, 0.5)
            remedy = f"Did you mean {' or '.join(close)}?" if close else f"There are {', '.join(sorted(VERBS))}."
            ctx.fail(f"There is no verb {name!r}. {remedy}")
        found = super().resolve_command(ctx, args)
        _wording().speak(found[1])
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl([(name, VERBS[name]) for name in sorted(VERBS)])


_LONGEST = 2000
"""How many characters of a message are shown; an argument quoted in it may be of any length."""

_SYSTEM = {
    **dict.fromkeys((errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EIO), 3),
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS), 4),
}
"""Exit codes for the operating system's errors about files."""

SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


@click.command(cls=Verbs, epilog=EPILOG, context_settings=SETTINGS)
@click.version_option(package_name="orograph")
@click.option("--debug", is_flag=True, envvar="OROGRAPH_DEBUG", help="Show the traceback of errors.")
@click.option("--quiet", "-q", is_flag=True, help="No progress on stderr.")
@click.pass_context
def cli(ctx: click.Context, debug: bool, quiet: bool) -> None:
    """Terrain visualisation: from any elevation raster to a picture whose numbers are true.

    \b
    Begin with:
      orograph info dem.tif                  what is in this file?
      orograph render dem.tif -o relief.png  a relief picture of it
      orograph view dem.tif                  a window to explore it in
      orograph build tiles/*.tif -o area.oro a store, for data larger than memory
    """
    ctx.ensure_object(dict)
    ctx.obj["debug"] = debug
    ctx.obj["quiet"] = quiet


def main(argv: list[str] | None = None) -> None:
    """Run the command line; turns every expected error into one paragraph on stderr and its exit code.

    With --debug a traceback takes the paragraph's place; the exit code stays the same.
    """
    args = sys.argv[1:] if argv is None else argv
    debug = "--debug" in args or bool(os.environ.get("OROGRAPH_DEBUG"))
    general = [a for a in args if a in ("--debug", "--quiet", "-q")]  # allowed anywhere on the line
    args = [*general, *(a for a in args if a not in general)]
    spare_imports(s3=any(a.startswith(("s3:", "/vsis3")) for a in args))
    try:
        if argv is None:
            stopping.guard(cleaning="view" not in args)
        _expect(args)
        code = cli.main(args=args, prog_name="orograph", standalone_mode=False)
        code = code if isinstance(code, int) else 0
        if argv is None:
            _compile_rest(quiet="--quiet" in args or "-q" in args)
            _leave(code)  # shutting down the interpreter and its libraries in order takes a quarter of a second
        sys.exit(code)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except (click.exceptions.Abort, KeyboardInterrupt) as error:
        click.echo("\norograph: interrupted", err=True)
        _leave(143 if isinstance(error.__cause__ or error, stopping.Stopped) else 130)
    except Exception as error:
        if stopping.asked():  # which a library turned into an error of its own
            stopping.end(stopping.asked())
        _fail(error, debug)


_OTHERWISE = {"-h", "--help", "gpu", "--backend=gpu", "--method", "--methods"}
"""Words of a command that needs other kernels than its verb usually does."""


def _wording() -> Any:
    """The module ``cli.wording``, loaded only when needed to keep start-up short."""
    return importlib.import_module("orograph.cli.wording")


def _fail(failure: Exception, debug: bool) -> NoReturn:
    """Print what failed and exit with its code."""
    try:
        raise failure
    except click.ClickException as error:
        if isinstance(error, click.NoSuchOption):
            _wording().lead(error)
        setattr(error, "message", _shortened(error.message))  # noqa: B010 (Final, for those who make one)
        error.show()
        sys.exit(error.exit_code)
    except OrographError as error:
        if debug:
            traceback.print_exc()
        else:
            click.echo(f"orograph: {_wording().spoken(_shortened(str(error)))}", err=True)
        _leave(error.exit_code)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        code, said = _users(error)
        if debug:
            traceback.print_exc()
        elif said:
            click.echo(f"orograph: {_shortened(said)}", err=True)
        else:
            click.echo(
                f"orograph: {type(error).__name__}: {error} This is a fault of Orograph itself; "
                "run it again with --debug to see where, and please report it.",
                err=True,
            )
        _leave(code)


def _users(error: Exception) -> tuple[int, str]:
    """Exit code and message for errors caused by the user or the system that no nearer code has described; 1 and "" for
    any other error."""
    if isinstance(error, OSError) and error.filename is not None and error.errno in _SYSTEM:
        return _SYSTEM[error.errno], f"{error.filename}: {error.strerror}."
    if isinstance(error, UnicodeEncodeError) and error.reason == "surrogates not allowed":
        return 2, f"{error.object!a} holds bytes that are not UTF-8 text."
    return 1, ""


def _shortened(text: str) -> str:
    """A message, with the middle of very long quoted parts removed."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} […] {text[-_LONGEST // 2 :]}"


def _expect(args: list[str]) -> None:
    """Have the kernels compiled that a verb surely needs, while it reads its options and its modules are loaded."""
    verb = next((a for a in args if not a.startswith("-")), "")
    if verb in ("demo", "render", "build", "tessellate", "tin", "compare") and not _OTHERWISE & set(args):
        from orograph.compiling import expect

        expect("render" if verb == "demo" else verb)


def _compile_rest(quiet: bool) -> None:
    """After a machine's first run at a terminal, compile the other verbs' kernels in the background."""
    if not sys.stderr.isatty() or "orograph.compiling" not in sys.modules:  # (nothing was compiled)
        return
    from orograph.compiling import compile_rest

    if compile_rest() and not quiet:
        click.echo("The other verbs' kernels are being compiled in the background, once for this machine.", err=True)


def _leave(code: int) -> NoReturn:
    """Exit at once, without waiting for worker threads that may still be busy with a cancelled block."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
