"""Texts that break files: markup, control characters, what UTF-8 or XML cannot hold."""

#: names that end an attribute, open a tag, or are not allowed in XML or UTF-8 at all
NASTY = ("a<b>&\"'", "]]>", "<!--", "&#0;", "line\nbreak\ttab", "\x00\x01\x1b[31m\x7f\x9f", "\udcff\ud800",
         "\ufffe\uffff", "\U0001fffe", "\u00b5 \u4e2d \U0001f600", " ")
