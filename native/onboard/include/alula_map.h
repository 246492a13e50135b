/* A cover as a map that a microcontroller reads directly from flash: layout version 1.
 *
 * Little-endian, read byte by byte, so no alignment is needed. Hull h of the map is its box cut by
 * oblique planes; all numbers are integers on a lattice of edge g, in the frame of the cover.
 *
 * Header, 64 bytes:
 *    0  4  magic "ALMP"                      24 12  int32 origin[3], added to all int16 coordinates
 *    4  1  version, major: 1                 36  4  float g [m], rounded to nearest
 *    5  1  version, minor: 0                 40  8  double g [m]
 *    6  2  bytes of the header: 64           48  4  float margin [m], see alula_map_evaluate
 *    8  2  flags                             52  8  first bytes of the SHA-256 of the cover's file
 *   10  1  largest |normal component|, >= 1  60  4  CRC-32 of bytes 0..59
 *   11  1  zero
 *   12  4  number of hulls n
 *   16  4  bytes of the whole image
 *   20  4  CRC-32 of bytes 64..end
 *
 * Then n records, and after them, with ALULA_MAP_INDEXED, the index up to the end of the image.
 * Record of a hull, 14 + 5 k bytes, or 14 + 2 k with ALULA_MAP_KDOP:
 *    0  6  int16 lower[3]    6  6  int16 upper[3]    12  1  k    13  1  shift
 *   14  .  k planes: int8 normal[3], uint16 depth; with ALULA_MAP_KDOP uint16, of which the low 5 bits
 *          number the normal (those of {-1, 0, 1}^3 with two or three non-zero components, in
 *          lexicographic order) and the high 11 bits are the depth
 *
 * The hull is {x in [lower, upper] : normal . (x - corner) <= -depth 2^shift}, where corner is the corner
 * of its box that lies farthest along the normal; depth is the depth of the cut from that corner.
 *
 * Index: a tree of boxes over the records in their order, with which a search skips most of them.
 *    0  1  records per leaf b, 1 to 255      1  1  levels      2  2  zero
 *    4  .  the nodes of level 0, the leaves, then of level 1 and so on up to the one root: int16 lower[3],
 *          upper[3], the exact union of the boxes below it. Leaf i holds the records b i to b i + b - 1, node i
 *          of a higher level the nodes 4 i to 4 i + 3 below; the last of a level may hold fewer.
 *    .  .  per leaf uint32, the byte at which its first record begins
 * So m = ceil(n / b) leaves and about m / 3 other nodes, of 12 bytes, and 4 m more bytes.
 *
 * No function reads outside the given bytes, and alula_map_open refuses every image that is not complete and valid.
 */
#ifndef ALULA_MAP_H
#define ALULA_MAP_H

#include "alula_onboard.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_MAP_HEADER_BYTES 64U
#define ALULA_MAP_HULL_BYTES 14U
#define ALULA_MAP_PLANE_BYTES 5U
#define ALULA_MAP_KDOP_PLANE_BYTES 2U
#define ALULA_MAP_KDOP 1U    /* flag: normals are numbers of directions */
#define ALULA_MAP_INDEXED 2U /* flag: an index follows the records */
#define ALULA_MAP_NODE_BYTES 12U
#define ALULA_MAP_FANOUT 4U  /* nodes under one of a higher level */
#define ALULA_MAP_LEVELS 13U /* for the maximum number of hulls, one per leaf */
#define ALULA_MAP_MOST_HULLS (1U << 24)
#define ALULA_MAP_NO_HULL UINT32_MAX

typedef enum {
  ALULA_MAP_READY = 0,
  ALULA_MAP_BAD_POINTER,
  ALULA_MAP_FOREIGN,     /* not an onboard map */
  ALULA_MAP_NEWER,       /* of a layout that this reader does not support */
  ALULA_MAP_TRUNCATED,   /* fewer bytes than the header states */
  ALULA_MAP_DAMAGED,     /* a CRC-32 does not match */
  ALULA_MAP_MALFORMED,   /* complete, but not valid in this layout */
  ALULA_MAP_BAD_POSITION /* not finite, or beyond 10^12 m */
} alula_map_status;

/* An open map; made by alula_map_open, valid as long as the bytes stay where they are. */
typedef struct {
  const uint8_t* data;
  uint32_t total_bytes; /* of the image; bytes after it are ignored */
  uint32_t records_end; /* first byte after the records */
  uint32_t hull_count;
  uint32_t plane_count; /* oblique planes of all hulls */
  uint32_t most_planes; /* maximum number of oblique planes of one hull */
  uint32_t plane_bytes; /* of one plane */
  uint32_t leaf_hulls;  /* 0 without an index */
  uint32_t level_count;
  uint32_t level_at[ALULA_MAP_LEVELS]; /* byte where the nodes of a level begin; level 0 are the leaves */
  uint32_t level_size[ALULA_MAP_LEVELS];
  uint32_t starts_at; /* byte where the list of the leaves' first records begins */
  int32_t origin[3];
  float voxel_size_m;
  float margin_m;
  float extent_m; /* 2^18 margin_m: no coordinate of the map is larger */
} alula_map;

/* One record. Coordinates are in units of g. */
typedef struct {
  int32_t lower[3], upper[3];
  uint32_t plane_count;
  uint32_t shift;
  const uint8_t* planes;
  uint32_t next; /* where the next record begins */
} alula_map_hull;

typedef struct {
  int32_t normal[3];
  uint32_t depth; /* in units of g: already multiplied by 2^shift */
} alula_map_plane;

/* psi at a position, and the hull and plane that decide it. */
typedef struct {
  float psi_m;     /* FLT_MAX for a map without hulls */
  uint32_t hull;   /* number of the record, or ALULA_MAP_NO_HULL */
  float normal[3]; /* unit outward normal of the deciding plane: psi grows along it */
} alula_map_value;

/* Checks an image of at most `length` bytes: magic, version, lengths, both CRC-32, every record and every
 * node of the index. Any result but ALULA_MAP_READY leaves an empty map. Time O(length), no memory besides *map. */
ALULA_MUST_USE alula_map_status alula_map_open(alula_map* map, const uint8_t* data, uint32_t length);

/* The record that begins at byte `at`: ALULA_MAP_HEADER_BYTES, then hull->next; ALULA_MAP_MALFORMED
 * when it does not lie within the records. Call it map->hull_count times. */
ALULA_MUST_USE alula_map_status alula_map_read(const alula_map* map, uint32_t at, alula_map_hull* hull);

/* Plane l < hull->plane_count of a record of this map. */
alula_map_plane alula_map_plane_at(const alula_map* map, const alula_map_hull* hull, uint32_t l);

/* A lower bound of psi at x [m], in the frame of the cover:
 *
 *   psi(p) = min_h psi_h(p),  psi_h(p) = max_l (n_l . p - d_l) / |n_l| over the six faces and k planes
 *
 * psi never exceeds the distance to the hulls of the cover, and is 1-Lipschitz. psi_m is at most psi(p)
 * for every p within three roundings (3 u E, u = 2^-24) of x in each coordinate, where E bounds all
 * |coordinates| of the map and of x. Faces cost 4 u E (g, its product, the difference); a plane, with
 * S = |n_1| + |n_2| + |n_3| <= sqrt 3 |n|: the faces 4 + 3, products 2, sums 4 + 2, the depth 4, so
 * 19 u E S / |n|, then root, quotient and product 3 u 2 sqrt 3 E: together 43.4 u E, and 3.5 u E for
 * subtracting the margin. The margin is 64 u E = 2^-18 E: margin_m up to extent_m, and larger beyond.
 *
 * Hulls with a box farther than the nearest hull so far are skipped, which changes no bit of the
 * result. Time at most O(hulls + planes). */
ALULA_MUST_USE alula_map_status alula_map_evaluate(const alula_map* map, const float x[3], alula_map_value* value);

#ifdef __cplusplus
}
#endif
#endif
