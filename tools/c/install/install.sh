#!/bin/sh
# Installs the library for C and C++ with its header, for pkg-config and for CMake.
#
#   install.sh BUILT PREFIX VERSION
#
# BUILT is the folder of libdecouplegs_c.so and libdecouplegs_c.a. What is installed may be moved: nothing in it names PREFIX.
set -eu
if [ $# -ne 3 ]; then
	echo "usage: install.sh BUILT PREFIX VERSION, found $# arguments" >&2
	exit 2
fi
built=$1 prefix=$2 version=$3
here=$(cd "$(dirname "$0")" && pwd)
abi=$(sed -n 's/^#define DGS_ABI_VERSION \([0-9]*\)$/\1/p' "$here/../include/decouplegs.h")
for library in libdecouplegs_c.so libdecouplegs_c.a; do
	if ! [ -f "$built/$library" ]; then
		echo "$built/$library is missing: build it with 'cargo build --release --package decouplegs-c'" >&2
		exit 1
	fi
done
umask 022
mkdir -p "$prefix/include" "$prefix/lib/pkgconfig" "$prefix/lib/cmake/decouplegs"

# Installs one file: it is there whole or not at all.
place() { # SOURCE TARGET MODE
	cp "$1" "$2.new"
	chmod "$3" "$2.new"
	mv "$2.new" "$2"
}

# Copies a library without the line tables of debuggers, which are nine tenths of it.
place_library() { # SOURCE TARGET MODE STRIP_OPTION
	cp "$1" "$2.new"
	if command -v strip >/dev/null; then strip "$4" "$2.new"; fi
	chmod "$3" "$2.new"
	mv "$2.new" "$2"
}

place "$here/../include/decouplegs.h" "$prefix/include/decouplegs.h" 644
shared="libdecouplegs_c.so.$abi"
place_library "$built/libdecouplegs_c.so" "$prefix/lib/$shared" 755 --strip-unneeded
place_library "$built/libdecouplegs_c.a" "$prefix/lib/libdecouplegs_c.a" 644 --strip-debug
ln -sfn "$shared" "$prefix/lib/libdecouplegs_c.so"
for name in decouplegs.pc decouplegs-config.cmake decouplegs-config-version.cmake; do
	case $name in
	*.pc) folder="$prefix/lib/pkgconfig" ;;
	*) folder="$prefix/lib/cmake/decouplegs" ;;
	esac
	sed -e "s/@VERSION@/$version/g" -e "s/@SHARED@/$shared/g" "$here/$name.in" >"$folder/$name.new"
	mv "$folder/$name.new" "$folder/$name"
done
echo "$prefix/lib/$shared, its header, and what pkg-config and CMake need"
