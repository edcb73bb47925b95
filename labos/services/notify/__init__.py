"""Notifies people: follows the log and keeps an outbox of its own.

``contacts`` says who is notified, when and how; ``notices`` reads events; ``schedule`` plans which contact
receives a notice when; ``outbox`` stores what will be sent and what was sent; ``channels`` sends;
``notifier`` puts these parts together. No part writes to the log or delays the kernel.
"""

from labos.services.notify.contacts import Book, Contact, load_contacts
from labos.services.notify.notices import TYPES
from labos.services.notify.notifier import Notifier
from labos.services.notify.outbox import Delivery, Outbox

__all__ = ["TYPES", "Book", "Contact", "Delivery", "Notifier", "Outbox", "load_contacts"]
