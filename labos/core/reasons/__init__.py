"""Reasons why a step does not start: a type for each, with its fields, its sentence and its remedy.

A new reason is added to one of the files in this folder, and to the union below. The type check then finds
all ``match`` statements that need a case for it.
"""

from __future__ import annotations

from labos.core.reasons._base import *
from labos.core.reasons._bench import *
from labos.core.reasons._modules import *
from labos.core.reasons._planning import *
from labos.core.reasons._run import *

AnyReason = RunReason | ModuleReason | BenchReason | PlanningReason
