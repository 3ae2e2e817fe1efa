#include "card_file.h"

#include <string.h>

#include "card.h"

#define NAME "INA219  BIN"
#define NAME_SIZE 11
#define ENTRY_SIZE 32
#define FOLDER_OR_LABEL 0x18

/* What the file system says of itself (Microsoft, FAT32 File System Specification, boot sector and BPB). */
typedef struct {
    uint32_t table; /* block of the first FAT */
    uint32_t root; /* block of the root folder */
    uint32_t root_blocks;
    uint32_t data; /* block of cluster 2 */
    uint8_t blocks_a_cluster;
    uint8_t is_fat32;
} volume_t;

static uint16_t get16(const uint8_t *from)
{
    return (uint16_t) (from[0] | from[1] << 8);
}

static uint32_t get32(const uint8_t *from)
{
    return get16(from) | (uint32_t) get16(from + 2) << 16;
}

static uint8_t is_boot_sector(const uint8_t *block)
{
    return !memcmp(block + 54, "FAT16", 5) || !memcmp(block + 82, "FAT32", 5);
}

/* Read the boot sector: the first block, or that of the first partition. Return its number, or -1. */
static uint32_t find_boot_sector(uint8_t *scratch)
{
    uint32_t partition = 0;
    if (!card_read(0, scratch))
        return UINT32_MAX;
    if (!is_boot_sector(scratch)) {
        partition = get32(scratch + 446 + 8);
        if (!card_read(partition, scratch) || !is_boot_sector(scratch))
            return UINT32_MAX;
    }
    return get16(scratch + 11) == CARD_BLOCK_SIZE ? partition : UINT32_MAX;
}

static uint32_t block_of(const volume_t *volume, uint32_t cluster)
{
    return volume->data + (cluster - 2) * volume->blocks_a_cluster;
}

static uint8_t open_volume(volume_t *volume, uint8_t *scratch)
{
    uint32_t boot = find_boot_sector(scratch);
    uint16_t table_blocks = get16(scratch + 22);
    if (boot == UINT32_MAX)
        return 0;
    volume->is_fat32 = table_blocks == 0;
    volume->blocks_a_cluster = scratch[13];
    volume->table = boot + get16(scratch + 14);
    volume->root = volume->table + scratch[16] * (volume->is_fat32 ? get32(scratch + 36) : (uint32_t) table_blocks);
    volume->root_blocks = get16(scratch + 17) / (CARD_BLOCK_SIZE / ENTRY_SIZE);
    volume->data = volume->root + volume->root_blocks;
    if (volume->is_fat32) { /* the root folder is a file; a new card's first cluster holds its beginning */
        volume->root = block_of(volume, get32(scratch + 44));
        volume->root_blocks = volume->blocks_a_cluster;
    }
    return 1;
}

/* Return the file's entry in the root folder, in the scratch, or a null pointer. */
static const uint8_t *find_entry(const volume_t *volume, uint8_t *scratch)
{
    uint32_t block;
    const uint8_t *entry;
    for (block = 0; block < volume->root_blocks; block++) {
        if (!card_read(volume->root + block, scratch))
            return 0;
        for (entry = scratch; entry < scratch + CARD_BLOCK_SIZE; entry += ENTRY_SIZE)
            if (!memcmp(entry, NAME, NAME_SIZE) && !(entry[11] & FOLDER_OR_LABEL))
                return entry;
    }
    return 0;
}

/* Return how many clusters lie on end from the first one on, `most` at most. */
static uint32_t run_length(const volume_t *volume, uint32_t first, uint32_t most, uint8_t *scratch)
{
    uint16_t entries = volume->is_fat32 ? CARD_BLOCK_SIZE / 4 : CARD_BLOCK_SIZE / 2;
    uint32_t cluster = first;
    uint32_t loaded = UINT32_MAX;
    uint32_t next;
    while (cluster - first + 1 < most) {
        if (cluster / entries != loaded) {
            loaded = cluster / entries;
            if (!card_read(volume->table + loaded, scratch))
                break;
        }
        next = volume->is_fat32 ? get32(scratch + cluster % entries * 4) & 0x0FFFFFFFUL
                                : get16(scratch + cluster % entries * 2);
        if (next != cluster + 1)
            break;
        cluster = next;
    }
    return cluster - first + 1;
}

uint8_t card_file_find(card_file_t *file, uint8_t *scratch)
{
    volume_t volume;
    const uint8_t *entry;
    uint32_t cluster;
    uint32_t clusters;
    uint32_t blocks;
    if (!open_volume(&volume, scratch))
        return 0;
    entry = find_entry(&volume, scratch);
    if (!entry)
        return 0;
    cluster = (volume.is_fat32 ? (uint32_t) get16(entry + 20) << 16 : 0) | get16(entry + 26);
    blocks = get32(entry + 28) / CARD_BLOCK_SIZE;
    if (cluster < 2 || blocks == 0)
        return 0;
    clusters = (blocks + volume.blocks_a_cluster - 1) / volume.blocks_a_cluster;
    clusters = run_length(&volume, cluster, clusters, scratch);
    file->first = block_of(&volume, cluster);
    file->count = clusters * volume.blocks_a_cluster < blocks ? clusters * volume.blocks_a_cluster : blocks;
    return 1;
}

/* Whether a block holds nothing; one that cannot be read counts as full, so that nothing is written over it. */
static uint8_t is_blank(uint32_t block, uint8_t *scratch)
{
    uint16_t at;
    if (!card_read(block, scratch))
        return 0;
    for (at = 0; at < CARD_BLOCK_SIZE; at++)
        if (scratch[at])
            return 0;
    return 1;
}

uint32_t card_file_end(const card_file_t *file, uint8_t *scratch)
{
    uint32_t low = 0; /* all blocks before it are full: recordings are written one behind the other */
    uint32_t high = file->count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (is_blank(file->first + middle, scratch))
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}
