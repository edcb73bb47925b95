"""Tells people of what needs them: a follower of the log with an outbox of its own.

``contacts`` says who is told, when and how; ``notices`` reads events; ``schedule`` plans who hears
of a notice when; ``outbox`` keeps what is to be sent and what was; ``channels`` sends; ``notifier``
puts them together. Nothing of it writes to the log or stands in the kernel's way.
"""

from labos.services.notify.contacts import Book, Contact, load_contacts
from labos.services.notify.notices import TYPES
from labos.services.notify.notifier import Notifier
from labos.services.notify.outbox import Delivery, Outbox

__all__ = ["TYPES", "Book", "Contact", "Delivery", "Notifier", "Outbox", "load_contacts"]
