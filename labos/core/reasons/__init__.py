"""Reasons why a step does not start: a type for each, with its fields, its sentence and its remedy.

A reason of a new kind stands in one of the files beside this one, and in the union at its end; the type check
then names the matches that have to know it.
"""

from __future__ import annotations

from labos.core.reasons._base import *
from labos.core.reasons._bench import *
from labos.core.reasons._modules import *
from labos.core.reasons._planning import *
from labos.core.reasons._run import *

AnyReason = RunReason | ModuleReason | BenchReason | PlanningReason
