"""``dopslam view``: the report of a run in the browser."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from http.server import ThreadingHTTPServer


def view(
    results: Path = Path("runs/latest"),
    *,
    open_: Annotated[bool, Parameter(name="--open")] = True,
    serve: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Open report.html of a results folder, made anew from its dataset where it is missing.

    Parameters
    ----------
    results
        Results folder, report.html, or a dataset file that holds a filter's history: beside its bound where there is
        a true track, as what was found where there is none.
    open_
        Show it in the browser; --no-open only makes it and prints its path.
    serve
        Serve the page on 127.0.0.1 instead until Ctrl-C, for a browser at the other end of an SSH tunnel.
    """
    import webbrowser

    from dopslam.errors import DatasetError
    from dopslam.pipeline import file as stages
    from dopslam.pipeline import found

    page = results / "report.html" if results.is_dir() else results
    if page.suffix != ".html" or not page.exists():
        data = results / "dataset.h5" if results.is_dir() else results
        if data.suffix == ".html" or not data.exists():
            raise DatasetError(
                f"{results}: neither a results folder with report.html or dataset.h5 nor a dataset; 'dopslam run' makes one"
            )
        page = data.with_name("report.html")
        if found.has_truth(data):
            stages.report(data, data.parent, *stages.evaluate(data))
        else:
            found.report(data, data.parent)
    print(f"report: {page.resolve()}")
    if serve:
        with server_of(page) as server:
            print(f"serving on http://127.0.0.1:{server.server_address[1]}/ until Ctrl-C", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                server.serve_forever()
    elif open_:
        webbrowser.open(page.resolve().as_uri())


def server_of(page: Path) -> ThreadingHTTPServer:
    """A server of one page, and of nothing else, that only this machine can reach."""
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

    content = page.read_bytes()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path.partition("#")[0] not in ("/", "/report.html"):
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: a page that is read is no event."""

    return ThreadingHTTPServer(("127.0.0.1", 0), Handler)
