"""``cosim docs``: serve the installed documentation, on this machine only."""

import argparse
from functools import partial
from typing import Any

from cosim.commands.command import Command


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port", type=int, default=0, metavar="N", help="port to serve on (default: one that is free)"
    )
    parser.add_argument("--where", action="store_true", help="print the folder of the pages, serve nothing")
    parser.add_argument("--open", action="store_true", help="open the first page in the browser")


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.assets import docs_folder
    from cosim.errors import fail

    folder = docs_folder()
    if args.where or args.json:
        return {"folder": str(folder), "first": str(folder / "index.html")}, str(folder)
    from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer  # 20 ms that no other command needs

    class Quiet(SimpleHTTPRequestHandler):
        """Serves files without printing a line for each."""

        def log_message(self, format: str, *args: Any) -> None:
            pass

    if not 0 <= args.port <= 65535:
        fail("is out of range", key="--port", value=args.port, allowed="0 to 65535")
    try:
        server = ThreadingHTTPServer(("127.0.0.1", args.port), partial(Quiet, directory=str(folder)))
    except OSError as error:
        fail(f"cannot be served on: {error.strerror}", key="--port", value=args.port)
    with server:
        address = f"http://127.0.0.1:{server.server_port}/"
        print(f"{address}  (Ctrl-C ends)", flush=True)
        if args.open:
            import webbrowser

            webbrowser.open(address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:  # the way it is meant to end
            pass
    return {"folder": str(folder)}, "ended"


COMMAND = Command("docs", "serve the documentation to this machine's browser", _arguments, _run)
