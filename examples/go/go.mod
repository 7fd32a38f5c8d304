// SPDX-License-Identifier: Apache-2.0
module clba.example

go 1.19
