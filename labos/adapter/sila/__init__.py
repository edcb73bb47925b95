"""SiLA 2: servers of laboratory devices that describe themselves."""

from labos.adapter.sila.node import MadsciSilaNode, SilaNode

__all__ = ["MadsciSilaNode", "SilaNode"]
