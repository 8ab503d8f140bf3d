"""A page that asks before it is left."""

import viser
from viser._messages import RunJavascriptMessage

ASK = "window.onbeforeunload = event => { event.preventDefault(); return ''; }"
LEAVE = "window.onbeforeunload = null"


def ask_before_leaving(client: viser.ClientHandle, ask: bool) -> None:
    """Have the browser ask whether the page may be closed or loaded again, or no longer."""
    # viser has no setting for it; this is how it brings scripts of its own to a page.
    client.gui._websock_interface.queue_message(RunJavascriptMessage(ASK if ask else LEAVE))
