# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's folder, for the command line and the server alike: how a run begins and goes on, who holds it, what
lies in it, and what is kept and shown of its training.
"""
