"""The command `taut`. Each subcommand is a module of its own, imported only when it is asked for."""

from __future__ import annotations

import json
import os
import sys

import click
from click.shell_completion import CompletionItem

from tautline import __version__
from tautline.cli._commands import COMMANDS, EXIT_STATUS, GROUPS, Said, import_module_of
from tautline.errors import TautError, nearest, of_system


class _Commands(click.Group):
    """click's group of commands. A command's module is imported only when the command is asked for; the help text lists
    the commands in groups."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of all commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Imports the command's module and returns the command, with its example appended to its help; None for an
        unknown name."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module_of(COMMANDS[cmd_name]).command
        example = f"Example: {COMMANDS[cmd_name].example}"
        if example not in (command.epilog or ""):
            command.epilog = "\n\n".join(filter(None, (command.epilog, example)))
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Does what click's own method does; but for an unknown name that is near a command's, the usage error says
        which command was probably meant."""
        if args[0] not in COMMANDS and (meant := nearest(args[0], COMMANDS)):
            ctx.fail(f"No such command '{args[0]}': did you mean 'taut {meant}'?")
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The shell's completions of `incomplete`: the commands that begin with it, whose modules are not imported, and
        then what click offers for any command (options)."""
        named = [CompletionItem(each.name, help=each.says) for each in COMMANDS.values()]
        return [each for each in named if each.value.startswith(incomplete)] + click.Command.shell_complete(
            self, ctx, incomplete
        )

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the commands into the help text, a section for each group."""
        wide = max(map(len, COMMANDS))
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{command.name:<{wide}}", command.says) for command in commands])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the exit statuses below the help text."""
        with formatter.section("Exit status"):
            formatter.write_dl([(str(status), says) for status, says in EXIT_STATUS.items()])


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="taut")
def taut() -> None:
    """Measures and undoes what a tendon-driven instrument loses between motor and tip."""


def main() -> None:
    """The entry point of `taut`: runs the command line. An error ends the process with a status of EXIT_STATUS and is
    printed as one line on stderr (one in the command line itself: below its usage; a closed output: not at all); with
    --json also as an object on stdout, unless the result was printed there already. The environment variable NO_COLOR
    removes colours; with TAUT_TRACEBACK=1 an unexpected error is raised with its traceback."""
    said = Said()
    try:
        taut(standalone_mode=False, obj=said, color=False if os.environ.get("NO_COLOR") else None)
    except click.ClickException as error:
        error.show()
        _exit_with_error(said, error.format_message(), 2 if isinstance(error, click.UsageError) else 1)
    except (click.Abort, KeyboardInterrupt):
        _fail(said, "stopped", 130)
    except TautError as error:
        _fail(said, str(error), error.status)
    except BrokenPipeError:  # nobody reads the output any more
        sys.exit(1)
    except OSError as error:
        if error.filename is None and os.environ.get("TAUT_TRACEBACK"):
            raise
        _fail(said, of_system(error), 1)
    except Exception as error:
        if os.environ.get("TAUT_TRACEBACK"):
            raise
        what = " ".join(str(error).split())
        _fail(said, f"internal error, {type(error).__name__}: {what} (TAUT_TRACEBACK=1 shows where)", 1)


def _fail(said: Said, what: str, status: int) -> None:
    """Prints the message `what` as a line on stderr and ends the process, as `_exit_with_error` does."""
    click.echo(f"taut: {what}", err=True)
    _exit_with_error(said, what, status)


def _exit_with_error(said: Said, what: str, status: int) -> None:
    """Ends the process with the exit status. With --json it first prints the message `what` as an object on stdout,
    unless the result was printed there already, as stdout gets a single object."""
    if "--json" in sys.argv and not said.result:
        click.echo(json.dumps({"error": what, "status": status}))
    sys.exit(status)
