"""Links of the pages: inline code with the place of a documented name leads to the API reference, and Markdown files
outside docs/ are downloads, as other files of the repository are."""

from __future__ import annotations

import os
import re

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

_PLACE = re.compile(r"hdsp(\.\w+)+")


class LinkNames(SphinxTransform):
    """Makes cross references of inline code; a name without a place in the reference stays code."""

    default_priority = 5

    def apply(self, **_options) -> None:
        for node in list(self.document.findall(nodes.literal)):
            text = node.astext()
            linked = isinstance(node.parent, nodes.reference | addnodes.pending_xref | addnodes.download_reference)
            if not linked and _PLACE.fullmatch(text):
                link = addnodes.pending_xref(
                    "", node.deepcopy(), refdomain="py", reftype="obj", reftarget=text, refdoc=self.env.docname,
                    refwarn=False, **{"py:module": None, "py:class": None},
                )  # fmt: skip
                node.replace_self(link)


class DownloadPages(SphinxTransform):
    """Makes downloads of links to Markdown files that are no pages of the site."""

    default_priority = 6

    def apply(self, **_options) -> None:
        folder = self.env.doc2path(self.env.docname).parent
        for node in list(self.document.findall(addnodes.pending_xref)):
            if node.get("refdomain") == "doc" and node["reftarget"] not in self.env.found_docs:
                path = self.env.doc2path(node["reftarget"], base=True).with_suffix(".md").resolve()
                if path.is_file():
                    target = os.path.relpath(path, folder.resolve())
                    node.replace_self(addnodes.download_reference("", *node.children, reftarget=target))


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_transform(LinkNames)
    app.add_transform(DownloadPages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
