"""The preview page: what is in it, and how it behaves in a real browser."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hashlib
import numpy as np
import pytest

from data_module import rotation
from data_module.errors import InputError
from data_module.skeletons import CHARACTER
from gesticulator.export import html, write
from tests.test_export import perform
