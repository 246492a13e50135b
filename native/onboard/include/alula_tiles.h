/* A map in tiles, of which two are in memory, in freestanding C99.
 *
 * `alula export COVER --tiles METRES --reach METRES` cuts the image of a cover (alula_map.h) into columns of the edge
 * METRES along x and y. Tile (i, j) has the positions with i e <= x < (i + 1) e and j e <= y < (j + 1) e; the tiles
 * at the rim of the index also have everything beyond them. The region of a tile is the tile grown by the hysteresis
 * along x and y. The image of a tile is a whole map: it has, in the order and with the bits of the whole image,
 *
 *   every hull with a box that meets the region grown by `reach` along x and y, and after them
 *   at most four walls: the rest of the box of all hulls, as boxes.
 *
 * So everything outside of the image is an obstacle in it. Two facts follow for all filters of this library:
 *
 *   safety    Every hull of the cover lies in a hull or a wall of every image. A filter that keeps its distance from
 *             the hulls of the resident image keeps it from the cover, wherever the vehicle is and however late the
 *             next tile comes: before the wall of a tile that is not loaded it stops as before any wall.
 *   equality  At a position in the region, hulls that are not in the image and walls have psi_h > reach, up to the
 *             rounding of alula_map_evaluate. A filter whose command no hull with psi_h > reach can change returns
 *             the command of the whole map, bit by bit: it evaluates the same hulls, in the same order, with the same
 *             rounding. For polytope-cbf, alula_polytope_cbf_reach is a sufficient reach.
 *
 * The caller owns two buffers, one per slot, and reads the images from wherever they are stored. Each tick:
 *
 *   place = alula_tiles_select(&tiles, position, towards, &map);
 *   if (place == ALULA_TILES_NOT_LOADED) -> no command: brake
 *   if (map has another image than before) alula_polytope_cbf_move(&filter, map);    (O(1))
 *
 * and in the background, while alula_tiles_request(&tiles, &request): read `request.bytes` bytes of the tile's file
 * into the buffer of `request.slot`, then alula_tiles_loaded(&tiles, buffer). That call checks all bytes. It and
 * alula_tiles_select must not run at the same time. The slot of the map that was selected last is never requested.
 *
 * A tile is left for another when the position is more than half the hysteresis outside of it and in the region of
 * the other, which is resident. So a vehicle that hovers at a border does not switch to and fro, and the new walls
 * are farther away than `reach`: a switch never makes psi less than the smaller of its value before and `reach`. The
 * tile to load is the one in which the way from the position straight to `towards` leaves the region; when it does
 * not leave it, the tile of `towards`. A load that has begun is finished first.
 *
 * Index, little-endian, 128 bytes and 40 per tile, x before y:
 *    0  4  magic "ALTI"                          80  8  first bytes of the SHA-256 of the cover's file
 *    4  1  version, major: 1                     88  4  CRC-32 of bytes 128..end
 *    5  1  version, minor: 0                     92 32  Merkle root of the tiles' SHA-256
 *    6  2  bytes of the header: 128             124  4  CRC-32 of bytes 0..123
 *    8  8  int32 first i, j                     then per tile:
 *   16  8  number of tiles along x, y             0  4  bytes of the image
 *   24  4  edge e of a tile, in units of g        4  4  CRC-32 of the image
 *   28  4  reach, in units of g                   8 32  SHA-256 of the image
 *   32  4  hysteresis, in units of g
 *   36  4  bytes of the largest image
 *   40  8  double g [m]
 *   48 24  int32 lower[3], upper[3] of the box of all hulls
 *   72  4  bytes of the index
 *   76  4  float g [m], rounded to nearest
 *
 * The signature of an index is its HMAC-SHA-256 under a key shared by the exporting and the flying machine. Each
 * image is checked against the SHA-256 in the index, so a key for the index protects all tiles.
 */
#ifndef ALULA_TILES_H
#define ALULA_TILES_H

#include "alula_map.h"
#include "alula_sha256.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_TILES_HEADER_BYTES 128U
#define ALULA_TILES_ROW_BYTES 40U
#define ALULA_TILES_SLOTS 2U
#define ALULA_TILES_MOST (1U << 24)
#define ALULA_TILES_NO_SLOT UINT32_MAX

typedef enum {
  ALULA_TILES_READY = 0,
  ALULA_TILES_BAD_POINTER,
  ALULA_TILES_FOREIGN,   /* not an index of tiles */
  ALULA_TILES_NEWER,     /* of a layout that this reader does not support */
  ALULA_TILES_TRUNCATED, /* fewer bytes than the header states */
  ALULA_TILES_DAMAGED,   /* a CRC-32 does not match, or an image is not the one of the index */
  ALULA_TILES_MALFORMED, /* complete, but not valid in this layout */
  ALULA_TILES_FORGED,    /* the signature does not match the key */
  ALULA_TILES_NO_REQUEST /* no tile is to be loaded */
} alula_tiles_status;

typedef enum {
  ALULA_TILES_INSIDE = 0, /* in the region of the selected tile: the commands of the whole map */
  ALULA_TILES_OUTSIDE,    /* outside of it, because the next tile is late: safe, and held back by walls */
  ALULA_TILES_NOT_LOADED  /* no tile near the position is resident, or it is not finite: there is no map */
} alula_tiles_place;

typedef struct {
  uint32_t tile; /* row of the index */
  int32_t at[2]; /* i, j */
  alula_map map; /* without data until it is resident */
} alula_tile_slot;

/* Initialised by alula_tiles_open; the fields are private, except the lengths. */
typedef struct {
  const uint8_t* index;
  int32_t first[2], last[2];
  uint32_t along_x;
  int32_t edge; /* in units of g */
  float voxel_size_m, edge_m, reach_m, hysteresis_m;
  uint32_t largest_bytes; /* of an image: the size of a buffer */
  alula_tile_slot slot[ALULA_TILES_SLOTS];
  uint32_t active, loading; /* slots, or ALULA_TILES_NO_SLOT */
} alula_tiles;

typedef struct {
  uint32_t slot; /* whose buffer to fill */
  uint32_t tile; /* row of the index */
  int32_t at[2]; /* i, j: the file tile_I_J.bin */
  uint32_t bytes;
} alula_tiles_request_data;

/* Checks an index of at most `length` bytes, and its signature of ALULA_SHA256_BYTES under a key; without a key
 * (null) the signature is not read. No tile is resident. The bytes must stay in place. Time O(length). */
ALULA_MUST_USE alula_tiles_status alula_tiles_open(alula_tiles* tiles, const uint8_t* index, uint32_t length,
                                                   const uint8_t* key, uint32_t key_length, const uint8_t* signature);

/* Selects the image for a position, and decides which tile to load. `towards` is where the vehicle may be when that
 * tile is there; the position itself if it is not finite. *map is null for ALULA_TILES_NOT_LOADED. Time O(1). */
ALULA_MUST_USE alula_tiles_place alula_tiles_select(alula_tiles* tiles, const float position[3],
                                                    const float towards[3], const alula_map** map);

/* Nonzero while a tile is to be loaded, which it describes. */
ALULA_MUST_USE int alula_tiles_request(const alula_tiles* tiles, alula_tiles_request_data* request);

/* Checks the image of the requested tile and makes it resident; its bytes must stay in place while it is. After any
 * result but ALULA_TILES_READY the tile is still requested. Time O(bytes). */
ALULA_MUST_USE alula_tiles_status alula_tiles_loaded(alula_tiles* tiles, const uint8_t* image);

#ifdef __cplusplus
}
#endif
#endif
